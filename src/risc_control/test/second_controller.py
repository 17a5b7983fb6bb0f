#!/usr/bin/env python3
"""A controller in another process, like a student's: slow, for the vehicle ~template alone. With ~torn it also sends
truncated messages.
"""

import contextlib
import io

import rospy

from risc_lab.ros.publisher_updates import init_node
from risc_msgs.msg import Control, Controls

RATE_HZ = 30.0


class Torn(Controls):
    """Controls without the second half of the message."""

    def serialize(self, buff):
        whole = io.BytesIO()
        super().serialize(whole)
        buff.write(whole.getvalue()[: len(whole.getvalue()) // 2])


def main():
    init_node("second_controller")
    publisher = rospy.Publisher("/controls", Controls, queue_size=1)
    template, hover_n = rospy.get_param("~template"), rospy.get_param("~hover_n")
    rate = rospy.Rate(RATE_HZ)
    while not rospy.is_shutdown():
        for kind in (Torn, Controls) if rospy.get_param_cached("~torn", False) else (Controls,):
            message = kind()
            message.header.stamp = rospy.Time.now()
            message.Obj.append(Control(template, 0.2, 0.2, 0.2, hover_n))
            publisher.publish(message)
        rate.sleep()


if __name__ == "__main__":
    with contextlib.suppress(rospy.ROSInterruptException):
        main()
