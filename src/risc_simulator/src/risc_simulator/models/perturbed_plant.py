"""The true vehicle behind the nominal one: parameters drawn around a vehicle type's values.

Controllers know only the nominal type. A virtual lab flies vehicles whose mass, thrust, attitude loops, drag
and link delay differ from it, as every real airframe does.
"""

from dataclasses import dataclass, replace

import numpy as np

from risc_lab.frames import GRAVITY_M_S2
from risc_lab.lab import AttitudeLoop

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
class PlantParams:
    """What one vehicle really is. Loops mean what they mean in VehicleType."""

    mass_kg: float
    nominal_mass_kg: float  # what its own climb loop believes in
    inertia_kg_m2: tuple[float, float, float]
    thrust_scale: float  # true thrust / demanded thrust
    roll: AttitudeLoop
    pitch: AttitudeLoop
    yaw_rate_time_constant_s: float
    climb_time_constant_s: float
    command_delay_s: float  # from sending to effect, beside the wait for the radio slot
    drag_n_s_m: float
    thrust_min_n: float
    thrust_max_n: float


def nominal_plant(vehicle_type):
    """PlantParams of a vehicle that is exactly what its type says."""
    weight_n = vehicle_type.mass_kg * GRAVITY_M_S2
    return PlantParams(
        mass_kg=vehicle_type.mass_kg,
        nominal_mass_kg=vehicle_type.mass_kg,
        inertia_kg_m2=tuple(vehicle_type.inertia_kg_m2),
        thrust_scale=1.0,
        roll=vehicle_type.roll,
        pitch=vehicle_type.pitch,
        yaw_rate_time_constant_s=vehicle_type.yaw_rate_time_constant_s,
        climb_time_constant_s=vehicle_type.climb_time_constant_s,
        command_delay_s=vehicle_type.command_delay_s,
        drag_n_s_m=vehicle_type.drag_n_s_m,
        thrust_min_n=IDLE_THRUST_TO_WEIGHT * weight_n,
        thrust_max_n=MAX_THRUST_TO_WEIGHT * weight_n,
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


_POSITIVE = (
    "mass_kg",
    "nominal_mass_kg",
    "inertia_x_kg_m2",
    "inertia_y_kg_m2",
    "inertia_z_kg_m2",
    "yaw_rate_time_constant_s",
    "climb_time_constant_s",
)


def fill_records(bodies, plants):
    """Write a sequence of PlantParams into records with QUADROTOR_FIELDS, in this order. Raises ValueError."""
    for body, plant in zip(bodies, plants):
        body.mass_kg = plant.mass_kg
        body.nominal_mass_kg = plant.nominal_mass_kg
        body.thrust_scale = plant.thrust_scale
        body.inertia_x_kg_m2, body.inertia_y_kg_m2, body.inertia_z_kg_m2 = plant.inertia_kg_m2
        body.roll_natural_frequency_rad_s = plant.roll.natural_frequency_rad_s
        body.roll_damping_ratio = plant.roll.damping_ratio
        body.roll_gain = plant.roll.gain
        body.pitch_natural_frequency_rad_s = plant.pitch.natural_frequency_rad_s
        body.pitch_damping_ratio = plant.pitch.damping_ratio
        body.pitch_gain = plant.pitch.gain
        body.yaw_rate_time_constant_s = plant.yaw_rate_time_constant_s
        body.climb_time_constant_s = plant.climb_time_constant_s
        body.drag_n_s_m = plant.drag_n_s_m
        body.thrust_min_n = plant.thrust_min_n
        body.thrust_max_n = plant.thrust_max_n
        body.tumble_damping_1_s = TUMBLE_DAMPING_1_S
    for name in _POSITIVE:
        if not np.all(bodies[name] > 0.0):
            raise ValueError("%s must be positive, got %r" % (name, bodies[name].tolist()))
