#!/usr/bin/env python3
"""Driver of a toy quadrotor, to the vehicle: topic toy/command, a text -> UDP 4050."""

import socket

import rospy
from std_msgs.msg import String

from risc_lab.ros.publisher_updates import init_node

init_node("toy_commands")
vehicle = rospy.get_param("~address"), 4050
sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
rospy.Subscriber("toy/command", String, lambda message: sock.sendto(message.data.encode(), vehicle), queue_size=10)
rospy.spin()
