"""The pilot of an IRIS+ lets go of the trainer switch and flies by hand and eye: to a stop, and up or down by this
height [m]. Meanwhile the channels that the transmitter's board sends are not received.
"""

import math

VELOCITY_S, HEIGHT_1_S2, CLIMB_1_S = 0.3, 2.0, 2.0  # gains: stick by velocity; lift by height error and climb rate
MOST = 0.3  # of full stick
CLIMB_M_S = 0.3


class Pilot:
    def __init__(self, climb_m):
        self._climb_m = climb_m

    def begin(self, vehicle, time_s):
        self._height_m, self._begin_s = vehicle.height_m, time_s

    def step(self, vehicle, time_s):
        state = vehicle.state
        (x_m_s, y_m_s, climb_m_s), cosine, sine = state.velocity_m_s, math.cos(state.psi), math.sin(state.psi)
        forward_m_s, right_m_s = x_m_s * cosine - y_m_s * sine, -x_m_s * sine - y_m_s * cosine
        sticks = (max(-MOST, min(MOST, VELOCITY_S * part)) for part in (-right_m_s, forward_m_s))
        gone_m = math.copysign(min(abs(self._climb_m), CLIMB_M_S * (time_s - self._begin_s)), self._climb_m)
        up_m_s2 = HEIGHT_1_S2 * (self._height_m + gone_m - vehicle.height_m) - CLIMB_1_S * climb_m_s
        vehicle.firmware.fly_by_hand((*sticks, 0.0, 1.0 + max(-1.0, min(1.0, up_m_s2)) / 9.81), time_s)

    def end(self, vehicle, time_s):
        vehicle.firmware.fly_by_hand(None, time_s)


def make(severity, rng):
    return Pilot(severity)
