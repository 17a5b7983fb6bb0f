"""Result of `./maap test --repeat N`: how often each test failed, from the JUnit files of its passes."""

import collections
import pathlib
import re
import sys
import xml.etree.ElementTree as ElementTree

BAD = ("failure", "error")


class Record:
    """Results of one test over all passes."""

    def __init__(self):
        self.passes = set()  # numbers of the passes in which it ran
        self.failed = set()  # of the passes in which it, its set-up or its tear-down failed
        self.skipped = set()
        self.reasons = collections.Counter()


def read(folder):
    """{name of a test: Record} of files "PASS.anything.xml", PASS counted from 1."""
    records = collections.defaultdict(Record)
    for path in sorted(pathlib.Path(folder).glob("*.xml")):
        number = int(re.match(r"\d+", path.name).group())
        for case in ElementTree.parse(path).iter("testcase"):
            record = records["%s::%s" % (case.get("classname", "").replace(".", "/"), case.get("name"))]
            record.passes.add(number)
            for result in case:
                if result.tag in BAD:
                    record.failed.add(number)
                    record.reasons[(result.get("message") or "").strip().partition("\n")[0][:150]] += 1
                elif result.tag == "skipped":
                    record.skipped.add(number)
    return dict(records)


def lines(records, passes):
    """(text lines, whether all is well): failures and gaps, most failures first, then a total."""
    found, well = [], bool(records)
    for name, record in sorted(records.items(), key=lambda item: (-len(item[1].failed), item[0])):
        missing, now_and_then = passes - len(record.passes), 0 < len(record.skipped) < len(record.passes)
        if not (record.failed or missing or now_and_then):
            continue
        well = False
        counts = [(len(record.failed), "failed"), (len(record.skipped), "skipped"), (missing, "without a result")]
        told = ", ".join("%d %s" % (count, what) for count, what in counts if count)
        found.append("%s of %d: %s" % (told, passes, name))
        found += ["    %d x %s" % (count, reason) for reason, count in record.reasons.most_common()]
    failures = sum(len(record.failed) for record in records.values())
    runs = sum(len(record.passes) for record in records.values())
    found.append("%d tests, %d passes, %d runs, %d failures" % (len(records), passes, runs, failures))
    return found, well


def main(folder, passes):
    text, well = lines(read(folder), int(passes))
    print("\n".join(text))
    return 0 if well else 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
