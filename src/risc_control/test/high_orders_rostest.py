#!/usr/bin/env python3
"""A controller of order 6 in the graph: the derivatives that it requests from the trajectory node are exact; so are the
covariances of the states, as long as there are fresh ones.
"""

import math
import threading
import unittest

import numpy as np
import rospy
import rostest
from rospy.numpy_msg import numpy_msg

from risc_control.delay_prediction import effective_delay_s
from risc_control.vehicles import Command, ControlsConverter
from risc_lab.lab import load_vehicle_type
from risc_lab.ros.publisher_updates import init_node
from risc_lab.states import S
from risc_maap_msgs.msg import StateCovariance, StateCovariances, TrajectoryDerivatives
from risc_msgs.msg import Controls, Cortex, States

RADIUS_M, FREQUENCY_RAD_S = 0.7, 2.0 * math.pi / 5.0  # of circle_traj.py
STATES, STATES_HZ = 300, 100.0
VARIANCE_M2, COVARIANCES = 0.25, 150  # of x; sent with the first states
OLD_S = 0.2  # ~state_timeout
TOLD = 0.1  # see members/controllers/sixth.py
TIMEOUT_S = 60.0


class HighOrdersTest(unittest.TestCase):
    def test_fifth_and_sixth_derivatives_are_exact_in_the_graph(self):
        told, commands, over = [], {}, threading.Event()
        rospy.Subscriber("/trajectory_derivatives", numpy_msg(TrajectoryDerivatives), told.append, queue_size=1000)
        states = rospy.Publisher("/cortex_raw", Cortex, queue_size=100)
        covariances = rospy.Publisher("/state_covariances", StateCovariances, queue_size=100)
        variances = np.zeros((len(S), len(S)))
        variances[S.X, S.X] = VARIANCE_M2
        others = StateCovariance("Raven", [1.0] * len(S) ** 2), StateCovariance("fluffy_II", variances.ravel().tolist())
        known_s = []  # stamps of the covariances

        def on_controls(message):
            if message.Obj:
                commands[message.header.stamp] = message.Obj[0]
            if len(commands) >= STATES:
                over.set()

        rospy.Subscriber("/controls", Controls, on_controls, queue_size=1000)

        def fly():
            rate = rospy.Rate(STATES_HZ)
            while not over.is_set() and not rospy.is_shutdown():
                message = Cortex(Obj=[States(name="fluffy_II", visible=True, z=1.0)])
                message.header.stamp = rospy.Time.now()
                states.publish(message)
                if commands and len(known_s) < COVARIANCES:
                    covariances.publish(StateCovariances(message.header, others))
                    known_s.append(message.header.stamp.to_sec())
                rate.sleep()

        threading.Thread(target=fly, daemon=True).start()
        self.assertTrue(over.wait(TIMEOUT_S), "%d commands" % len(commands))

        first = told[0]
        self.assertEqual(first.names, ["fluffy_II"])
        sample = first.derivatives.reshape(-1, 1, 4)
        self.assertEqual(len(sample), 14)
        phase_0 = math.atan2(sample[0, 0, 1], sample[0, 0, 0])

        def derivatives(time_s, orders):
            """(orders,) of x"""
            phase = phase_0 + FREQUENCY_RAD_S * (time_s - first.header.stamp.to_sec())
            k = np.arange(orders)
            return RADIUS_M * FREQUENCY_RAD_S**k * np.cos(phase + 0.5 * math.pi * k)

        for message in told:  # the stamp is that of the host's clock, the course runs by the monotonic one
            found = message.derivatives.reshape(-1, 1, 4)[:, 0, 0]
            np.testing.assert_allclose(found, derivatives(message.header.stamp.to_sec(), 14), rtol=0, atol=1e-3)
        kind = load_vehicle_type("ardrone")
        tenth, nobody = np.array([0.1]), np.zeros(1, dtype=bool)
        units, _ = ControlsConverter([kind])(Command(tenth, tenth, tenth, 5.0 + tenth), ~nobody, nobody)
        variances_m2 = {
            stamp.to_sec() - known_s[0]: 0.1 * command.psi / units.psi[0] for stamp, command in commands.items()
        }
        last_s = known_s[-1] - known_s[0]
        while_m2 = [variance for age_s, variance in variances_m2.items() if 0.1 < age_s < last_s]
        after_m2 = [variance for age_s, variance in variances_m2.items() if age_s > last_s + OLD_S + 0.02]
        self.assertGreater(min(len(while_m2), len(after_m2)), 50)
        np.testing.assert_allclose(while_m2, VARIANCE_M2, rtol=1e-6)
        np.testing.assert_array_equal(after_m2, 0.0)
        errors = []
        for stamp, command in commands.items():
            found = np.array([command.phi / units.phi[0], command.theta / units.theta[0]]) * 0.1 / TOLD
            # it takes effect after sending, some milliseconds after the stamp, and after the delay of the link
            ahead_s = stamp.to_sec() + effective_delay_s(kind) + np.arange(0.0, 0.05, 0.001)
            expected = np.array([derivatives(time_s, 7)[5:] for time_s in ahead_s])
            errors.append(np.abs(expected - found).max(axis=1).min())
        self.assertLess(np.median(errors), 2e-3)


if __name__ == "__main__":
    init_node("high_orders_test")
    rostest.rosrun("risc_control", "high_orders_test", HighOrdersTest)
