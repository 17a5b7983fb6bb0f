"""The true vehicle behind the nominal one: parameters drawn around a vehicle type's values.

Controllers know only the nominal type. An honest virtual lab flies vehicles whose mass, thrust, attitude loops, drag
and link delay differ from it, as every real airframe does.
"""

from dataclasses import dataclass, replace
from typing import Tuple

import numpy as np

from risc_control.frames import GRAVITY_M_S2
from risc_control.lab import AttitudeLoop
from risc_simulator.models.quadrotor import QuadrotorParams

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
    inertia_kg_m2: Tuple[float, float, float]
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


def draw_plant(vehicle_type, rng, honest=True):
    """PlantParams of one vehicle of this type.

    rng: numpy Generator of this vehicle alone, so that a draw does not depend on who else flies.
    honest=False gives the nominal vehicle (the generator is not used).
    """
    plant = nominal_plant(vehicle_type)
    if not honest:
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


def stack_plants(plants):
    """QuadrotorParams of a sequence of PlantParams: one column per vehicle, in this order."""

    def column(value):
        return np.array([value(plant) for plant in plants], dtype=float)

    return QuadrotorParams(
        mass_kg=column(lambda p: p.mass_kg),
        nominal_mass_kg=column(lambda p: p.nominal_mass_kg),
        thrust_scale=column(lambda p: p.thrust_scale),
        inertia_x_kg_m2=column(lambda p: p.inertia_kg_m2[0]),
        inertia_y_kg_m2=column(lambda p: p.inertia_kg_m2[1]),
        inertia_z_kg_m2=column(lambda p: p.inertia_kg_m2[2]),
        roll_natural_frequency_rad_s=column(lambda p: p.roll.natural_frequency_rad_s),
        roll_damping_ratio=column(lambda p: p.roll.damping_ratio),
        roll_gain=column(lambda p: p.roll.gain),
        pitch_natural_frequency_rad_s=column(lambda p: p.pitch.natural_frequency_rad_s),
        pitch_damping_ratio=column(lambda p: p.pitch.damping_ratio),
        pitch_gain=column(lambda p: p.pitch.gain),
        yaw_rate_time_constant_s=column(lambda p: p.yaw_rate_time_constant_s),
        climb_time_constant_s=column(lambda p: p.climb_time_constant_s),
        drag_n_s_m=column(lambda p: p.drag_n_s_m),
        thrust_min_n=column(lambda p: p.thrust_min_n),
        thrust_max_n=column(lambda p: p.thrust_max_n),
        tumble_damping_1_s=np.full(len(plants), TUMBLE_DAMPING_1_S),
    )
