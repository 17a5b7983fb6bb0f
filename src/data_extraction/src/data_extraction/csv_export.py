"""Bag to CSV, one file a topic, in one pass and in bounded memory."""

import csv
import pathlib

from data_extraction.bags import Bag
from data_extraction.flatten import flatten


def file_name(topic):
    """CSV file name of a topic: /risc1/ardrone/navdata -> risc1_ardrone_navdata.csv."""
    return topic.strip("/").replace("/", "_") + ".csv"


class CsvTopic:
    """Writes the rows of one topic; columns that appear later are added at the right, earlier rows stay empty there."""

    def __init__(self, path):
        self.path = pathlib.Path(path)
        self.rows = 0
        self._columns = []
        self._known = set()
        self._header_written = []
        self._file = self.path.open("w+", newline="", encoding="utf-8")
        self._writer = csv.writer(self._file)

    def write(self, row):
        """Append one row, a dict {column: value}."""
        if not self._known.issuperset(row):
            new = [column for column in row if column not in self._known]
            self._columns += new
            self._known.update(new)
            if not self._header_written:
                self._header_written = list(self._columns)
                self._writer.writerow(self._header_written)
        self._writer.writerow([row.get(column, "") for column in self._columns])
        self.rows += 1

    def close(self):
        """Finish the file. When columns were added after the first row, the header and short rows are completed."""
        self._file.close()
        if self._header_written == self._columns:
            return
        complete = self.path.with_suffix(".csv.tmp")
        with (
            self.path.open(newline="", encoding="utf-8") as old,
            complete.open("w", newline="", encoding="utf-8") as new,
        ):
            writer = csv.writer(new)
            writer.writerow(self._columns)
            rows = csv.reader(old)
            next(rows)
            for row in rows:
                writer.writerow(row + [""] * (len(self._columns) - len(row)))
        complete.replace(self.path)


class CsvExport:
    """CSV files of all topics that are fed to it, in one folder. Use as a context manager."""

    def __init__(self, folder):
        self.folder = pathlib.Path(folder)
        self._topics = {}

    def __enter__(self):
        self.folder.mkdir(parents=True, exist_ok=True)
        return self

    def __exit__(self, *exception):
        for topic in self._topics.values():
            topic.close()

    def write(self, topic, receipt_s, message):
        """Append one message. The first column is its time of receipt [s]."""
        if topic not in self._topics:
            self._topics[topic] = CsvTopic(self.folder / file_name(topic))
        row = {"receipt": "%.6f" % receipt_s}
        for column, value in flatten(message).items():
            row[column] = "%.6f" % value if column == "stamp" else value
        self._topics[topic].write(row)

    def files(self):
        """{topic: (path, number of rows)}."""
        return {name: (topic.path, topic.rows) for name, topic in self._topics.items()}


def export(bag_path, folder, topics=None, on_message=None):
    """Write the topics of a bag (all by default) as CSV files. Returns {topic: (path, rows)}.

    on_message: called as on_message(topic, receipt_s, message) for each message, so that one pass can serve more.
    Raises BagError, from `Bag`.
    """
    with Bag(bag_path) as bag:
        return export_open(bag, folder, topics, on_message)


def export_open(bag, folder, topics=None, on_message=None):
    """As `export`, of a Bag that is open already."""
    with CsvExport(folder) as csv_export:
        for topic, receipt_s, message in bag.messages(topics):
            csv_export.write(topic, receipt_s, message)
            if on_message is not None:
                on_message(topic, receipt_s, message)
        return csv_export.files()
