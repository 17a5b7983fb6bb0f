"""Bag to CSV, one file a topic, in one pass and in bounded memory."""

import csv
import pathlib

from data_extraction.flatten import flatten


def file_name(topic):
    """CSV file name of a topic: /risc1/ardrone/navdata -> risc1_ardrone_navdata.csv."""
    return topic.strip("/").replace("/", "_") + ".csv"


class _CsvTopic:
    """Writes the rows of one topic; columns that appear later are added at the right, earlier rows stay empty there."""

    def __init__(self, path):
        self.path, self.rows = path, 0
        self._columns = {}  # -> None, in their order
        self._header = []  # as it was written with the first row
        self._file = path.open("w", newline="", encoding="utf-8")
        self._writer = csv.DictWriter(self._file, self._columns, extrasaction="ignore")

    def write(self, row):
        """Append one row, a dict {column: value}."""
        self._columns.update(dict.fromkeys(row))
        if not self._header:
            self._header = list(self._columns)
            self._writer.writeheader()
        self._writer.writerow(row)
        self.rows += 1

    def close(self):
        """Finish the file. When columns were added after the first row, the header and short rows are completed."""
        self._file.close()
        if self._header == list(self._columns):
            return
        complete = self.path.with_suffix(".csv.tmp")
        with (
            self.path.open(newline="", encoding="utf-8") as old,
            complete.open("w", newline="", encoding="utf-8") as new,
        ):
            writer, rows = csv.writer(new), csv.reader(old)
            next(rows)
            writer.writerow(self._columns)
            writer.writerows(row + [""] * (len(self._columns) - len(row)) for row in rows)
        complete.replace(self.path)


def export(bag, folder, topics=None, on_message=None):
    """Write the topics of an open Bag (all by default) as CSV files. Returns {topic: (path, rows)}.

    The first column is the time of receipt [s]. on_message: called as on_message(topic, receipt_s, message) for each
    message, so that one pass can serve more. Raises BagError, from `Bag`.
    """
    folder = pathlib.Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    files = {}
    try:
        for topic, receipt_s, message in bag.messages(topics):
            if topic not in files:
                files[topic] = _CsvTopic(folder / file_name(topic))
            row = {"receipt": "%.6f" % receipt_s, **flatten(message)}
            if "stamp" in row:
                row["stamp"] = "%.6f" % row["stamp"]
            files[topic].write(row)
            if on_message is not None:
                on_message(topic, receipt_s, message)
    finally:
        for file in files.values():
            file.close()
    return {topic: (file.path, file.rows) for topic, file in files.items()}
