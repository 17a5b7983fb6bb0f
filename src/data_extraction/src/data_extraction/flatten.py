"""One message becomes one row: nested fields become columns with readable names. Pure; no bag, no ROS."""

import dataclasses
import functools

import numpy as np


def flatten(message):
    """Row of a message as a dict {column: value}, in the order of the message's fields.

    - `header` gives the columns `stamp` [s], `seq`, `frame_id`; other times and durations become seconds;
    - nested fields are joined with dots: `linear.x`;
    - an element of an array that has a name is called by it: `fluffy_II.x`, so that columns stay in place when the
      order of `Obj[]` changes; a name that occurs twice in one array gets its index: `fluffy_II[1].x`; one that another
      array of the same message has taken already gets its own array's name: `quads.Raven.azim`;
    - elements without a name are numbered: `ranges[3]`;
    - binary arrays (images) become their length in bytes.

    message: an object as the rosbags library deserialises it (a dataclass).
    """
    row = {}
    for name in _names(type(message)):
        value = getattr(message, name)
        is_message = dataclasses.is_dataclass(value)
        if is_message and name == "header":
            row.update(stamp=seconds(value.stamp), seq=getattr(value, "seq", 0), frame_id=value.frame_id)
        elif is_message and _names(type(value)) == ("sec", "nanosec"):
            row[name] = seconds(value)
        elif is_message:
            row.update(_below(name, flatten(value)))
        elif isinstance(value, np.ndarray) and value.dtype == np.uint8 and len(value) > 64:
            row[name + ".bytes"] = len(value)
        elif isinstance(value, (list, tuple, np.ndarray)):
            _add_array(row, name, value.tolist() if isinstance(value, np.ndarray) else value)
        else:
            row[name] = value
    return row


def seconds(time):
    """Seconds [s] of a ROS time or duration as rosbags gives it."""
    return time.sec + 1e-9 * time.nanosec


def stamp_or_receipt_s(message, receipt_s):
    """Stamp [s] of a message; its receipt when nobody stamped it, as in the original release."""
    return seconds(message.header.stamp) or receipt_s


def _below(name, row):
    return {"%s.%s" % (name, column): value for column, value in row.items()}


def _add_array(row, name, items):
    seen = set()
    for index, item in enumerate(items):
        if not dataclasses.is_dataclass(item):
            row["%s[%d]" % (name, index)] = item
            continue
        inner, own_name = flatten(item), getattr(item, "name", "")
        label = own_name or "%s[%d]" % (name, index)
        if label in seen:
            label = "%s[%d]" % (label, index)
        seen.add(label)
        if own_name:
            del inner["name"]
        columns = _below(label, inner)
        row.update(columns if row.keys().isdisjoint(columns) else _below(name, columns))


@functools.cache
def _names(kind):
    """Names of a message's fields without its constants, which rosbags gives as fields that belong to the class."""
    return tuple(field.name for field in dataclasses.fields(kind) if not str(field.type).startswith("ClassVar"))
