#!/usr/bin/env python3
"""Labelled pictures from a bag: motion capture says what every camera saw (COCO JSON). Needs no ROS master."""

import argparse
import sys

from data_extraction.command_line import bag_parser, fleet_of, folder_beside, run
from data_extraction.labels import LabelParams, label


def main():
    """Command line. Returns the exit code."""
    default = LabelParams()
    parser = bag_parser("label_images.py", __doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    parser.add_argument("-t", "--topics", nargs="+", help="topics of pictures (all image_raw and image_rect_color)")
    parser.add_argument("--states", default=default.states_topic, help="topic that says where the vehicles were")
    parser.add_argument("--delay", type=float, default=default.delay_s, help="[s] exposure to stamp of a picture")
    parser.add_argument("--min-fraction", type=float, default=default.min_fraction, help="of an object in the picture")
    parser.add_argument("--min-size", type=float, default=default.min_size_px, help="[px] least side of a box")
    parser.add_argument("--max-distance", type=float, default=default.max_distance_m, help="[m]")
    parser.add_argument("--every", type=int, default=default.every, help="take every nth picture of a camera")
    parser.add_argument("--format", choices=("jpg", "png"), default=default.format, help="of the pictures")
    parser.add_argument("--overlay", action="store_true", help="also write the pictures with their labels drawn in")
    args = parser.parse_args()

    def work(progress):
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
        folder = args.out or folder_beside(args.bag, "labels")
        result = label(args.bag, folder, fleet_of(args.bag, args.fleet), params, args.topics, progress)
        progress.clear()
        print("%d pictures, %d labels  %s" % (result.pictures, result.labels, result.path))
        if result.without_pose:
            print("%d pictures left out: motion capture did not see their vehicle just then" % result.without_pose)

    return run("label_images", work)


if __name__ == "__main__":
    sys.exit(main())
