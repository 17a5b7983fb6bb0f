"""The true vehicle behind the nominal one: parameters drawn around a vehicle type's values.

Controllers know only the nominal type. A virtual lab flies vehicles whose mass, thrust, attitude loops, drag
and link delay differ from it, as every real airframe does.
"""

from dataclasses import dataclass, fields, replace

import numpy as np

from risc_lab.frames import GRAVITY_M_S2
from risc_lab.lab import AttitudeLoop
from risc_lab.settings import NotNegative, Positive, Settings

# One standard deviation of each property; draws are cut at two of them.
MASS_SPREAD = 0.03  # battery, hull and markers
THRUST_SPREAD = 0.03  # propellers, battery voltage
LOOP_BANDWIDTH_SPREAD = 0.15  # natural frequency of each attitude loop
DRAG_SPREAD = 0.20
DELAY_SPREAD_S = 0.020
MIN_DELAY_S = 0.001  # a radio link is never faster than this
_CUT_SIGMA = 2.0

MAX_THRUST_TO_WEIGHT = 1.8  # at nominal mass, full battery
IDLE_THRUST_TO_WEIGHT = 0.1  # running rotors never stop pushing
TUMBLE_DAMPING_1_S = 6.0  # air damping of hull and standing propellers


@dataclass(frozen=True)
class PlantParams(Settings):
    """What one vehicle really is. Loops mean what they mean in VehicleType."""

    mass_kg: Positive
    nominal_mass_kg: Positive  # what its own climb loop believes in
    inertia_kg_m2: tuple[Positive, Positive, Positive]
    thrust_scale: Positive  # true thrust / demanded thrust
    roll: AttitudeLoop
    pitch: AttitudeLoop
    yaw_rate_time_constant_s: Positive
    climb_time_constant_s: Positive
    command_delay_s: NotNegative  # from sending to effect, beside the wait for the radio slot
    drag_n_s_m: NotNegative  # linear drag force per velocity relative to the air
    thrust_min_n: NotNegative
    thrust_max_n: Positive


def nominal_plant(vehicle_type):
    """PlantParams of a vehicle that is exactly what its type says."""
    weight_n = vehicle_type.mass_kg * GRAVITY_M_S2
    names = [item.name for item in fields(PlantParams) if hasattr(vehicle_type, item.name)]
    return PlantParams(
        nominal_mass_kg=vehicle_type.mass_kg,
        thrust_scale=1.0,
        thrust_min_n=IDLE_THRUST_TO_WEIGHT * weight_n,
        thrust_max_n=MAX_THRUST_TO_WEIGHT * weight_n,
        **{name: getattr(vehicle_type, name) for name in names},
    )


def draw_plant(vehicle_type, rng, perturbed=True):
    """PlantParams of one vehicle of this type.

    rng: numpy Generator of this vehicle alone, so that a draw does not depend on who else flies.
    perturbed=False gives the nominal vehicle (the generator is not used).
    """
    plant = nominal_plant(vehicle_type)
    if not perturbed:
        return plant
    mass, thrust, roll, pitch, drag, delay = np.clip(rng.standard_normal(6), -_CUT_SIGMA, _CUT_SIGMA).tolist()
    return replace(
        plant,
        mass_kg=plant.mass_kg * (1.0 + MASS_SPREAD * mass),
        thrust_scale=1.0 + THRUST_SPREAD * thrust,
        roll=_scaled(plant.roll, 1.0 + LOOP_BANDWIDTH_SPREAD * roll),
        pitch=_scaled(plant.pitch, 1.0 + LOOP_BANDWIDTH_SPREAD * pitch),
        drag_n_s_m=plant.drag_n_s_m * (1.0 + DRAG_SPREAD * drag),
        command_delay_s=max(MIN_DELAY_S, plant.command_delay_s + DELAY_SPREAD_S * delay),
    )


def _scaled(loop, bandwidth_scale):
    return replace(loop, natural_frequency_rad_s=loop.natural_frequency_rad_s * bandwidth_scale)


def fill_records(bodies, plants):
    """Write a sequence of PlantParams into records with QUADROTOR_FIELDS, in this order."""
    for body, plant in zip(bodies, plants):
        body.inertia_x_kg_m2, body.inertia_y_kg_m2, body.inertia_z_kg_m2 = plant.inertia_kg_m2
        body.tumble_damping_1_s = TUMBLE_DAMPING_1_S
        for name, value in vars(plant).items():
            if isinstance(value, AttitudeLoop):
                for what, number in vars(value).items():
                    body["%s_%s" % (name, what)] = number
            elif name in body.dtype.names:
                body[name] = value
