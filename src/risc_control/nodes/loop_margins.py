#!/usr/bin/env python3
"""Margins of the control loop: see risc_experiments.loop_margins, which flies it offline."""

import sys

from risc_experiments.loop_margins import main

if __name__ == "__main__":
    sys.exit(main())
