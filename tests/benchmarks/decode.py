"""Time to decode a 16-body frame with the C++ library."""

import argparse
import pathlib
import subprocess
import sys


def main():
    """Command line. Returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=pathlib.Path, required=True)
    args = parser.parse_args()
    program = ["rosrun", "cortex_ros", "cortex_decode_bench"]
    print(subprocess.run(program, check=True, stdout=subprocess.PIPE, text=True).stdout, end="")
    figures = subprocess.run([*program, "--json"], check=True, stdout=subprocess.PIPE, text=True).stdout
    args.json.write_text(figures, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
