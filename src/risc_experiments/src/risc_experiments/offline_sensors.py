"""On-board measurements in flights without ROS, for filters that ask for them (filters.VelocityFilter.ON_BOARD).

From the virtual vehicle to the filter everything is as in the ROS graph: sensors, packets, the driver's message, the
readings made of it. A vehicle's packets pass a wire, e.g. risc1/navdata. The first one is sent at a random time.
"""

import numpy as np

from risc_estimation import sensors
from risc_estimation.filters import COMMAND

WAY_S = 0.001  # from the measurement to the driver, which stamps the message
_STREAM = 1002  # spawn key beside those of `offline`


class OnBoardReadings:
    """On-board readings of a fleet; none when the estimator's filter asks for none."""

    def __init__(self, estimator, vehicles, wires, seed, noise):
        """vehicles: world.Vehicles, still on the floor.  noise: factor on the noise of their sensors.

        Raises ImportError without ROS, whose messages the readings are made of.
        """
        self._estimator, self._sources = estimator, []
        if estimator.on_board_wanted <= {COMMAND}:
            return
        from std_msgs.msg import Header

        self._header = Header
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_STREAM,)))
        for vehicle in vehicles:
            kind, make = sensors.of_type(vehicle.type.name), vehicle.virtual.Telemetry
            if kind is not None and make is not None:
                telemetry = make(vehicle, seed, noise)
                wire = wires.wire("%s/%s" % (vehicle.namespace, telemetry.channel))
                self._sources.append([rng.uniform(0.0, telemetry.period_s), vehicle.name, kind, telemetry, wire])

    def send(self, time_s):
        """Let all vehicles that are due at world time time_s measure and send."""
        for source in self._sources:
            due_s, _, _, telemetry, wire = source
            if due_s <= time_s:
                source[0] = due_s + telemetry.period_s
                wire.carry(telemetry.packet(time_s), source, time_s + WAY_S, self._receive)

    def _receive(self, packet, source, arrival_s):
        from rospy import Time

        _, name, kind, telemetry, _ = source
        message = telemetry.message(packet, self._header(stamp=Time.from_sec(arrival_s)))
        if message is not None:
            sensors.give(self._estimator, name, kind, message)
