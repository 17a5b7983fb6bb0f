#!/usr/bin/env python3
"""Bag to CSV: one file per topic. Needs no ROS master."""

import sys

from data_extraction.bags import Bag
from data_extraction.command_line import bag_parser, folder_beside, run
from data_extraction.csv_export import export


def main():
    """Command line. Returns the exit code."""
    parser = bag_parser("bag_to_csv.py", __doc__, fleet=False)
    parser.add_argument("-t", "--topics", nargs="+", help="topics to export (default: all)")
    parser.add_argument("-l", "--list", action="store_true", help="only list the topics")
    args = parser.parse_args()

    def work(_progress):
        with Bag(args.bag) as bag:
            if args.list:
                for topic, count in sorted(bag.topics.items()):
                    print("%8d  %s" % (count, topic))
                return
            for path, rows in export(bag, args.out or folder_beside(args.bag, "csv"), args.topics).values():
                print("%8d rows  %s" % (rows, path))

    return run("bag_to_csv", work)


if __name__ == "__main__":
    sys.exit(main())
