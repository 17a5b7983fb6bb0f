#!/usr/bin/env python3
"""Driver of a toy quadrotor, from the vehicle: asks on UDP 4051; publishes state and charge on toy/status."""

import socket

import rospy
from std_msgs.msg import Float32MultiArray

from risc_lab.ros.publisher_updates import init_node

init_node("toy_status")
publisher = rospy.Publisher("toy/status", Float32MultiArray, queue_size=10)
sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
sock.settimeout(0.5)
rate = rospy.Rate(20.0)
while not rospy.is_shutdown():
    sock.sendto(b"?", (rospy.get_param("~address"), 4051))
    try:
        publisher.publish(data=[float(word) for word in sock.recv(64).split()])
    except OSError as error:
        rospy.logwarn_throttle(5.0, "the toy does not answer: %s" % error)
    rate.sleep()
