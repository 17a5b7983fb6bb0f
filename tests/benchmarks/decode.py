"""Time to decode a 16-body frame with the C++ library."""

import argparse
import json
import pathlib
import subprocess
import sys


def main():
    """Command line. Returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=pathlib.Path, required=True)
    args = parser.parse_args()
    program = ["rosrun", "cortex_ros", "cortex_decode_bench"]
    figures = subprocess.run(program, check=True, stdout=subprocess.PIPE, text=True).stdout
    print(
        "decode of a frame of %(bodies)d bodies x %(markers)d markers (%(bytes)d bytes), %(iterations)d times: "
        "median %(median_us).3f us, p99 %(p99_us).3f us" % json.loads(figures)
    )
    args.json.write_text(figures, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
