"""One message becomes one row: nested fields become columns with readable names. Pure; no bag, no ROS."""

import dataclasses

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

    message: an object as the rosbags library deserialises it (a dataclass). Raises TypeError for anything else.
    """
    if not dataclasses.is_dataclass(message):
        raise TypeError("flatten takes a deserialised message, got %r" % type(message).__name__)
    row = {}
    _add_fields(row, "", message)
    return row


def seconds(time):
    """Seconds [s] of a ROS time or duration as rosbags gives it."""
    return time.sec + 1e-9 * time.nanosec


def stamp_or_receipt_s(message, receipt_s):
    """Stamp [s] of a message; its receipt when nobody stamped it, as in the original release."""
    return seconds(message.header.stamp) or receipt_s


def _add_fields(row, prefix, message):
    for field in dataclasses.fields(message):
        if not _is_constant(field):
            _add(row, prefix, field.name, getattr(message, field.name))


def _add(row, prefix, name, value):
    if name == "header" and dataclasses.is_dataclass(value):
        row[prefix + "stamp"] = seconds(value.stamp)
        row[prefix + "seq"] = getattr(value, "seq", 0)
        row[prefix + "frame_id"] = value.frame_id
    elif dataclasses.is_dataclass(value):
        if _is_time(value):
            row[prefix + name] = seconds(value)
        else:
            _add_fields(row, prefix + name + ".", value)
    elif isinstance(value, np.ndarray):
        if value.dtype == np.uint8 and len(value) > 64:
            row[prefix + name + ".bytes"] = len(value)
        else:
            for index, item in enumerate(value.tolist()):
                row["%s%s[%d]" % (prefix, name, index)] = item
    elif isinstance(value, (list, tuple)):
        _add_array(row, prefix, name, value)
    else:
        row[prefix + name] = value


def _add_array(row, prefix, name, items):
    seen = set()
    for index, item in enumerate(items):
        if not dataclasses.is_dataclass(item):
            row["%s%s[%d]" % (prefix, name, index)] = item
            continue
        own_name = getattr(item, "name", "")
        label = own_name or "%s[%d]" % (name, index)
        if label in seen:
            label = "%s[%d]" % (label, index)
        seen.add(label)
        inner = _inner_fields(prefix + label, item, own_name)
        if not row.keys().isdisjoint(inner):
            inner = _inner_fields("%s%s.%s" % (prefix, name, label), item, own_name)
        row.update(inner)


def _inner_fields(label, item, own_name):
    inner = {}
    _add_fields(inner, label + ".", item)
    if own_name:
        inner.pop(label + ".name")
    return inner


def _is_time(value):
    return {field.name for field in dataclasses.fields(value) if not _is_constant(field)} == {"sec", "nanosec"}


def _is_constant(field):
    """Whether a field belongs to the class: rosbags gives the constants of a message so, and its type."""
    return str(field.type).startswith("ClassVar")
