#!/usr/bin/env python3
"""Label the pictures of a bag by means of motion capture (COCO JSON). Needs no ROS master."""

import sys
from dataclasses import fields

from data_extraction.command_line import bag_parser, fleet_of, folder_beside, run
from data_extraction.labels import LabelParams, label
from risc_lab.settings import settings_from

OPTIONS = {  # option -> (setting, help text)
    "--states": ("states_topic", "topic that says where the vehicles were"),
    "--delay": ("delay_s", "[s] exposure to stamp of a picture"),
    "--min-fraction": ("min_fraction", "of an object in the picture"),
    "--min-size": ("min_size_px", "[px] least side of a box"),
    "--max-distance": ("max_distance_m", "[m]"),
    "--every": ("every", "take every nth picture of a camera"),
    "--format": ("format", "of the pictures: jpg or png"),
}


def main():
    """Command line. Returns the exit code."""
    parser = bag_parser("label_images.py", __doc__)
    topics = "topics of pictures (default: all image_raw and image_rect_color)"
    parser.add_argument("-t", "--topics", nargs="+", help=topics)
    for option, (field, text) in OPTIONS.items():
        default = getattr(LabelParams, field)
        text += " (default: %(default)s)"
        parser.add_argument(option, dest=field, type=type(default), default=default, help=text)
    parser.add_argument("--overlay", action="store_true", help="also write the pictures with their labels drawn in")
    args = parser.parse_args()

    def work(progress):
        params = settings_from(LabelParams, {field.name: getattr(args, field.name) for field in fields(LabelParams)})
        folder = args.out or folder_beside(args.bag, "labels")
        fleet = fleet_of(args.bag, args.fleet)
        path, pictures, labels, without_pose = label(args.bag, folder, fleet, params, args.topics, progress)
        progress.clear()
        print("%d pictures, %d labels  %s" % (pictures, labels, path))
        if without_pose:
            print("%d pictures left out: motion capture did not see their vehicle at that time" % without_pose)

    return run("label_images", work)


if __name__ == "__main__":
    sys.exit(main())
