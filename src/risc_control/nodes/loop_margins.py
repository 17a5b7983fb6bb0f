#!/usr/bin/env python3
"""Margins of the control loop: risc_experiments.loop_margins, which flies it offline, under a name for rosrun."""

import runpy

if __name__ == "__main__":
    runpy.run_module("risc_experiments.loop_margins", run_name="__main__", alter_sys=True)
