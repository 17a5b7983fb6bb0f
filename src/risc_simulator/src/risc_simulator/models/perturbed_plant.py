"""The true vehicle behind the nominal one: parameters drawn around a vehicle type's values.

Controllers know only the nominal type. A virtual lab flies vehicles that differ from it in everything that
config/perturbed_plant.yaml names, as every real airframe does.
"""

import functools
from dataclasses import dataclass, fields, replace

import numpy as np

from risc_lab.frames import GRAVITY_M_S2
from risc_lab.lab import AttitudeLoop
from risc_lab.lab.yaml_reader import load_yaml, package_file
from risc_lab.settings import NotNegative, Positive, Settings, between, settings_from

MIN_DELAY_S = 0.001  # a radio link is never faster than this
_CUT_SIGMA = 2.0

MAX_THRUST_TO_WEIGHT = 1.8  # at nominal mass, full battery
IDLE_THRUST_TO_WEIGHT = 0.1  # running rotors always give some thrust
TUMBLE_DAMPING_1_S = 6.0  # air damping of hull and standing propellers


_Share = between(0.0, 0.4)  # of a value that has to stay positive at two standard deviations


@dataclass(frozen=True)
class Spreads(Settings):
    """Content of config/perturbed_plant.yaml, which explains each field."""

    mass: _Share
    thrust: _Share
    bandwidth: _Share
    damping: _Share
    gain: _Share
    yaw_rate_time_constant: _Share
    climb_time_constant: _Share
    drag: _Share
    delay_s: NotNegative
    level_rad: NotNegative
    climb_scale: _Share
    climb_bias_m_s: NotNegative


@functools.cache
def spreads():
    """Spreads of every vehicle. Raises ValueError that names the file and the key."""
    path = package_file("risc_simulator", "config/perturbed_plant.yaml")
    return settings_from(Spreads, load_yaml(path), str(path))


@dataclass(frozen=True)
class PlantParams(Settings):
    """True parameters of one vehicle. Loops are as in VehicleType."""

    mass_kg: Positive
    nominal_mass_kg: Positive  # the mass that its own climb loop assumes
    inertia_kg_m2: tuple[Positive, Positive, Positive]
    thrust_scale: Positive  # true thrust / demanded thrust
    roll: AttitudeLoop
    pitch: AttitudeLoop
    yaw_rate_time_constant_s: Positive
    climb_time_constant_s: Positive
    command_delay_s: NotNegative  # from sending to effect, without the wait for the radio slot
    drag_n_s_m: NotNegative  # linear drag force per velocity relative to the air
    roll_level_rad: float  # angle that it reaches when it is commanded to be level
    pitch_level_rad: float
    climb_scale: Positive  # climb rate as its own sensors measure it: scale * true one + bias
    climb_bias_m_s: float
    thrust_min_n: NotNegative
    thrust_max_n: Positive


def nominal_plant(vehicle_type):
    """PlantParams of a vehicle that is exactly what its type says."""
    weight_n = vehicle_type.mass_kg * GRAVITY_M_S2
    names = [item.name for item in fields(PlantParams) if hasattr(vehicle_type, item.name)]
    return PlantParams(
        nominal_mass_kg=vehicle_type.mass_kg,
        thrust_scale=1.0,
        roll_level_rad=0.0,
        pitch_level_rad=0.0,
        climb_scale=1.0,
        climb_bias_m_s=0.0,
        thrust_min_n=IDLE_THRUST_TO_WEIGHT * weight_n,
        thrust_max_n=MAX_THRUST_TO_WEIGHT * weight_n,
        **{name: getattr(vehicle_type, name) for name in names},
    )


def draw_plant(vehicle_type, rng, perturbed=True):
    """PlantParams of one vehicle of this type.

    rng: numpy Generator of this vehicle alone, so that a draw does not depend on the other vehicles.
    perturbed=False gives the nominal vehicle (the generator is not used).
    """
    plant = nominal_plant(vehicle_type)
    if not perturbed:
        return plant
    spread = spreads()
    mass, thrust, roll, pitch, drag, delay = _draws(rng, 6)  # the order is fixed: a seed must give the same plants
    roll_damping, pitch_damping, roll_gain, pitch_gain, yaw_rate, climb = _draws(rng, 6)
    roll_level, pitch_level, climb_scale, climb_bias = _draws(rng, 4)
    return replace(
        plant,
        mass_kg=plant.mass_kg * (1.0 + spread.mass * mass),
        thrust_scale=1.0 + spread.thrust * thrust,
        roll=_drawn(plant.roll, spread, roll, roll_damping, roll_gain),
        pitch=_drawn(plant.pitch, spread, pitch, pitch_damping, pitch_gain),
        yaw_rate_time_constant_s=plant.yaw_rate_time_constant_s * (1.0 + spread.yaw_rate_time_constant * yaw_rate),
        climb_time_constant_s=plant.climb_time_constant_s * (1.0 + spread.climb_time_constant * climb),
        drag_n_s_m=plant.drag_n_s_m * (1.0 + spread.drag * drag),
        command_delay_s=max(MIN_DELAY_S, plant.command_delay_s + spread.delay_s * delay),
        roll_level_rad=spread.level_rad * roll_level,
        pitch_level_rad=spread.level_rad * pitch_level,
        climb_scale=1.0 + spread.climb_scale * climb_scale,
        climb_bias_m_s=spread.climb_bias_m_s * climb_bias,
    )


def _draws(rng, count):
    return np.clip(rng.standard_normal(count), -_CUT_SIGMA, _CUT_SIGMA).tolist()


def _drawn(loop, spread, bandwidth, damping, gain):
    return AttitudeLoop(
        natural_frequency_rad_s=loop.natural_frequency_rad_s * (1.0 + spread.bandwidth * bandwidth),
        damping_ratio=loop.damping_ratio * (1.0 + spread.damping * damping),
        gain=loop.gain * (1.0 + spread.gain * gain),
    )


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
