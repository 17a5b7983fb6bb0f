#!/usr/bin/env python3
"""Labelled pictures from a bag: motion capture says what every camera saw (COCO JSON). Needs no ROS master."""

import argparse
import pathlib
import sys

from data_extraction.bags import BagError
from data_extraction.labels import LabelParams, label
from risc_lab.lab import load_fleet


def main():
    """Command line. Returns the exit code."""
    defaults = LabelParams()
    parser = argparse.ArgumentParser(
        prog="label_images.py", description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("bag", type=pathlib.Path)
    parser.add_argument("-o", "--out", type=pathlib.Path, help="folder for pictures and labels.json (beside the bag)")
    parser.add_argument("-f", "--fleet", type=pathlib.Path, help="fleet file (fleet.yaml beside the bag, if there)")
    parser.add_argument("-t", "--topics", nargs="+", help="topics of pictures (all image_raw and image_rect_color)")
    parser.add_argument("--states", default=defaults.states_topic, help="topic that says where the vehicles were")
    parser.add_argument("--delay", type=float, default=defaults.delay_s, help="[s] exposure to stamp of a picture")
    parser.add_argument("--min-fraction", type=float, default=defaults.min_fraction, help="of an object in the picture")
    parser.add_argument("--min-size", type=float, default=defaults.min_size_px, help="[px] least side of a box")
    parser.add_argument("--max-distance", type=float, default=defaults.max_distance_m, help="[m]")
    parser.add_argument("--every", type=int, default=defaults.every, help="take every nth picture of a camera")
    parser.add_argument("--format", choices=("jpg", "png"), default=defaults.format, help="of the pictures")
    parser.add_argument("--overlay", action="store_true", help="also write the pictures with their labels drawn in")
    args = parser.parse_args()
    folder = args.out or args.bag.with_suffix("").with_name(args.bag.stem + "_labels")
    beside = args.bag.parent / "fleet.yaml"
    fleet_file = args.fleet or (beside if beside.exists() else None)
    try:
        params = LabelParams(
            delay_s=args.delay,
            min_fraction=args.min_fraction,
            min_size_px=args.min_size,
            max_distance_m=args.max_distance,
            every=args.every,
            overlay=args.overlay,
            format=args.format,
            states_topic=args.states,
        )
        result = label(
            args.bag,
            folder,
            load_fleet(fleet_file) if fleet_file else None,
            params,
            args.topics,
            progress=lambda count: print("\r%d pictures" % count, end="", file=sys.stderr, flush=True),
        )
    except (BagError, ValueError, OSError) as error:
        print("label_images: %s" % error, file=sys.stderr)
        return 1
    print("\r%d pictures, %d labels  %s" % (result.pictures, result.labels, result.path))
    if result.without_pose:
        print("%d pictures left out: motion capture did not see their vehicle just then" % result.without_pose)
    return 0


if __name__ == "__main__":
    sys.exit(main())
