#!/usr/bin/env python3
"""Bag to CSV: one file a topic. Needs no ROS master."""

import argparse
import pathlib
import sys

from data_extraction.bags import Bag, BagError
from data_extraction.csv_export import export


def main():
    """Command line. Returns the exit code."""
    parser = argparse.ArgumentParser(prog="bag_to_csv.py", description=__doc__)
    parser.add_argument("bag", type=pathlib.Path)
    parser.add_argument("-o", "--out", type=pathlib.Path, help="folder for the files (default: beside the bag)")
    parser.add_argument("-t", "--topics", nargs="+", help="topics to export (default: all)")
    parser.add_argument("-l", "--list", action="store_true", help="only list the topics")
    args = parser.parse_args()
    try:
        if args.list:
            with Bag(args.bag) as bag:
                for topic, count in sorted(bag.topics.items()):
                    print("%8d  %s" % (count, topic))
            return 0
        folder = args.out or args.bag.with_suffix("").with_name(args.bag.stem + "_csv")
        for path, rows in export(args.bag, folder, args.topics).values():
            print("%8d rows  %s" % (rows, path))
    except BagError as error:
        print("bag_to_csv: %s" % error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
