"""From the velocity command of ROS to the sticks of the aircraft.

cmd_vel (x forward, y left, z up, rotation counter-clockwise from above; fractions of the configured limits) becomes
the arguments of AT*PCMD_MAG (roll + right, pitch + nose up = backward, gaz + up, yaw + clockwise from above).
"""

import math
from collections import namedtuple

from ardrone_autonomy.protocol.at import PcmdFlag

# Below this magnitude in all six values the aircraft holds its position by itself.
HOVER_THRESHOLD = 1e-6


# Arguments of PCMD_MAG; flags: PcmdFlag as a plain int, the four others in [-1, 1], signs of the aircraft.
Sticks = namedtuple("Sticks", "flags roll pitch gaz yaw")
HOVER = Sticks(0, 0.0, 0.0, 0.0, 0.0)


def sticks_from_velocity(linear, angular):
    """Return the Sticks for one geometry_msgs/Twist.

    linear, angular: (x, y, z) as in the Twist.  linear.x + forward, linear.y + left, linear.z + up, angular.z
    + counter-clockwise from above; clipped to [-1, 1].  angular.x and angular.y only count for the hover rule:
    all six below HOVER_THRESHOLD -> HOVER, else the sticks are used even if they are zero (level, position not held).
    ValueError when one of the six is not finite.
    """
    six = (*linear, *angular)
    if not all(map(math.isfinite, six)):
        raise ValueError("cmd_vel contains a non-finite value: linear %r, angular %r" % (linear, angular))
    if all(abs(value) < HOVER_THRESHOLD for value in six):
        return HOVER
    forward, left, up, counter_clockwise = (max(-1.0, min(1.0, value)) for value in (*linear, angular[2]))
    return Sticks(int(PcmdFlag.PROGRESSIVE), roll=-left, pitch=-forward, gaz=up, yaw=-counter_clockwise)
