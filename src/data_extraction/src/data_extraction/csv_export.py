"""Bag to CSV, one file per topic, in one pass and in bounded memory."""

import csv
import pathlib

from data_extraction.flatten import Flattener


def file_name(topic):
    """CSV file name of a topic: /risc1/ardrone/navdata -> risc1_ardrone_navdata.csv."""
    return topic.strip("/").replace("/", "_") + ".csv"


class _CsvTopic:
    """Writes the rows of one topic; columns that appear later are added at the right, earlier rows stay empty there."""

    def __init__(self, path):
        self.path, self.rows = path, 0
        self._flattener = Flattener()
        self._columns = {"receipt": None}  # in order; a field of the same name replaces it
        self._header = []  # as it was written with the first row
        self._newest = None  # columns of the newest row
        self._stamp, self._in_order = None, True  # index of its stamp; whether its columns are the first of the file
        self._file = path.open("w", newline="", encoding="utf-8")
        self._writer = csv.writer(self._file)

    def write(self, receipt_s, message):
        """Append the row of a message; receipt_s [s]: its first column."""
        columns, values = self._flattener(message)
        if columns is not self._newest:
            self._adopt(columns)
        if self._stamp is not None:
            values[self._stamp] = "%.6f" % values[self._stamp]
        receipt = "%.6f" % receipt_s
        if not self._in_order:
            row = {"receipt": receipt, **dict(zip(columns, values))}
            self._writer.writerow([row.get(column, "") for column in self._columns])
        else:
            self._writer.writerow([receipt, *values])
        self.rows += 1

    def _adopt(self, columns):
        self._newest, self._stamp = columns, columns.index("stamp") if "stamp" in columns else None
        self._columns.update(dict.fromkeys(columns))
        self._in_order = ("receipt", *columns) == tuple(self._columns)[: len(columns) + 1]
        if not self._header:
            self._header = list(self._columns)
            self._writer.writerow(self._header)

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
    message, so that one pass over the bag can serve other purposes too. Raises BagError, from `Bag`.
    """
    folder = pathlib.Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    files = {}
    try:
        for topic, receipt_s, message in bag.messages(topics):
            if topic not in files:
                files[topic] = _CsvTopic(folder / file_name(topic))
            files[topic].write(receipt_s, message)
            if on_message is not None:
                on_message(topic, receipt_s, message)
    finally:
        for file in files.values():
            file.close()
    return {topic: (file.path, file.rows) for topic, file in files.items()}
