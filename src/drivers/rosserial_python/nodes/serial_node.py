#!/usr/bin/env python3
"""serial_node: the topics of a microcontroller that uses rosserial, see the README of the package."""

from risc_lab.ros import low_latency
from risc_lab.ros.node import run
from rosserial_python.ros.node import SerialNode

if __name__ == "__main__":
    run("serial_node", SerialNode, start=low_latency.start, spin=low_latency.spin)
