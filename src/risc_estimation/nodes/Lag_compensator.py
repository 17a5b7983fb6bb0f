#!/usr/bin/env python3
"""The delay compensation under its old name: risc_control.ros.compensator_node, beside the controllers' predictor."""

import runpy

if __name__ == "__main__":
    runpy.run_module("risc_control.ros.compensator_node", run_name="__main__", alter_sys=True)
