#!/usr/bin/env python3
"""The delay compensation: risc_control.ros.compensator_node, where the controllers' predictor is, by its old name."""

import runpy

if __name__ == "__main__":
    runpy.run_module("risc_control.ros.compensator_node", run_name="__main__", alter_sys=True)
