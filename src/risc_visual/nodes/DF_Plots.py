#!/usr/bin/env python3
"""The course's plots, live or from a bag given as argument. See data_extraction.course_plots."""

import contextlib
import math
import pathlib
import sys
import threading
import time
from dataclasses import replace

import rospy
from sensor_msgs.msg import Joy
from std_srvs.srv import Trigger, TriggerResponse

from data_extraction import course_plots
from data_extraction.recording import COMMANDS, REFERENCES, STATES
from data_extraction.segments import OPERATOR, PHASES, PLOT_BUTTON, SENT, PlotParams, Recorder
from risc_control.joystick import ButtonPresses
from risc_control.ros.joystick_buttons import claim_buttons, origin
from risc_lab.ros.paced_subscriber import PacedSubscriber
from risc_lab.ros.params import fleet_vehicles, load_params
from risc_lab.ros.publisher_updates import init_node
from risc_maap_msgs.msg import CommandsSent, OperatorState, TrajectoryPhases
from risc_msgs.msg import Controls, Cortex, Trajectories
from risc_visual.ros.node import Health

_COUNTED = STATES, REFERENCES, COMMANDS  # on /diagnostics
_LOOK_S = 1.0  # how often the main thread checks for something to draw, and for shutdown


class DFPlots:
    """/cortex_raw, /trajectory, /controls -> files of ended segments; a button or ~plot also asks for current ones."""

    def __init__(self):
        fleet = fleet_vehicles()
        params = load_params(PlotParams)[0]
        if params.plot_button < 0:
            params = replace(params, plot_button=rospy.get_param("/plot_button", PLOT_BUTTON))
            if params.plot_button < 0:
                raise ValueError("parameter /plot_button must be a button (0, 1, ...), found %d" % params.plot_button)
        if params.euler_angle_max < 0.0:
            params = replace(params, euler_angle_max=rospy.get_param("/euler_angle_max", params.euler_angle_max))
        self._params = params
        self._recorder = Recorder(params, fleet)
        self._lock = threading.Lock()  # of the recorder
        self._folder = pathlib.Path(params.folder or time.strftime("df_plots_%Y%m%d-%H%M%S")).expanduser().absolute()
        self._folder.mkdir(parents=True, exist_ok=True)
        self._writer = course_plots.PageWriter(self._folder, params.pdf)
        self._drawing = threading.Lock()  # of the writer
        self._wanted = threading.Event()
        self._health = Health("DF_Plots", _COUNTED, done="logged")
        rospy.Service("~plot", Trigger, lambda _request: TriggerResponse(*self._plot()))
        joysticks = params.joysticks or ["joy"] + ["/%s/joy" % vehicle.namespace for vehicle in fleet]
        topics = sorted(set(map(rospy.resolve_name, joysticks)))
        claim_buttons({"plot_button": params.plot_button}, topics)
        for topic in topics:
            # Of any age: plots move no vehicle, and messages of a played bag are old.
            presses = ButtonPresses((params.plot_button,), math.inf)
            rospy.Subscriber(topic, Joy, self._on_joy, presses, queue_size=10, tcp_nodelay=True)
        for topic, kind in ((PHASES, TrajectoryPhases), (OPERATOR, OperatorState), (SENT, CommandsSent)):
            rospy.Subscriber(topic, kind, self._on_message, topic, queue_size=10, tcp_nodelay=True)
        for topic, kind in zip(_COUNTED, (Cortex, Trajectories, Controls)):
            PacedSubscriber(topic, kind, self._on_message, params.rate_hz, (topic,))
        rospy.loginfo("plots go to %s: those of the course under way on button %d", self._folder, params.plot_button)

    def run(self):
        """Until the node ends, draw ended and requested segments: here, not in the joystick's thread."""
        drawn = 0
        while not rospy.is_shutdown():
            asked = self._wanted.wait(_LOOK_S)
            if asked:
                self._wanted.clear()
            with self._lock:
                ended = self._recorder.ended()
            if asked or ended > drawn:
                self._plot(growing=asked)
                drawn = ended
        with self._lock:
            self._recorder.finish()
        self._plot()
        with contextlib.suppress(OSError):
            self._folder.rmdir()  # only an empty folder can be removed

    def _on_message(self, message, topic):
        with self._lock:
            self._recorder.take(topic, rospy.get_time(), message, rospy.Time.to_sec)
        if topic in _COUNTED:
            self._health.drawn(topic)

    def _on_joy(self, message, presses):
        if presses.update(message.buttons, sender=origin(message)[1]).in_time:
            self._wanted.set()

    def _plot(self, growing=True):
        """Write new files. Returns (whether there are segments, text of the result)."""
        with self._drawing:
            with self._lock:
                segments = self._recorder.segments(growing)
            files = self._writer.write(segments)
        if segments:
            text = "%d segments, %d new files in %s" % (len(segments), len(files), self._folder)
        else:
            text = "nothing to plot: no vehicle was seen for %g s while it had a course" % self._params.min_s
        if files or growing:
            rospy.loginfo("%s", text)
        return bool(segments), text


def main():
    arguments = rospy.myargv()[1:]
    if arguments:
        return course_plots.main(arguments)
    init_node("DF_Plots")
    try:
        DFPlots().run()
    except (ValueError, OSError) as error:
        rospy.logfatal("DF_Plots: %s", error)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
