"""One message becomes one row: nested fields become columns with readable names. Pure; no bag, no ROS."""

import dataclasses
import functools

import numpy as np

_SCALARS, _ARRAYS = {bool, int, float, str}, (list, tuple, np.ndarray)
_TIME = ("sec", "nanosec")
_MOST_NUMBERS = 64  # a longer array of bytes counts as binary
_MOST_SHAPES = 256  # sets of columns that are remembered per topic


class Flattener:
    """Messages of one topic as rows.

    - `header` gives the columns `stamp` [s], `seq`, `frame_id`; other times and durations become seconds;
    - nested fields are joined with dots: `linear.x`;
    - an element of an array that has a name is called by it: `fluffy_II.x`, so that columns stay in place when the
      order of `Obj[]` changes; a name that occurs twice in one array gets its index: `fluffy_II[1].x`; a name that an
      earlier array of the message has used already gets the name of its own array: `quads.Raven.azim`;
    - elements without a name are numbered: `ranges[3]`;
    - binary arrays (images) become their length in bytes.
    """

    def __init__(self):
        self._columns = {}  # {key of `_add_values`: columns}

    def __call__(self, message):
        """(columns: tuple of str, values: list of the same length), in the order of the message's fields.

        message: an object as the rosbags library deserialises it (a dataclass). For messages of the same shape the
        columns are worked out once and are the same tuple object.
        """
        values, key = [], []
        _add_values(message, "", values, key)
        columns = self._columns.get(key := tuple(key))
        if columns is None:
            if len(self._columns) >= _MOST_SHAPES:
                self._columns.clear()
            columns = self._columns[key] = tuple(_columns(message))
        return columns, values


def seconds(time):
    """Seconds [s] of a ROS time or duration as rosbags gives it."""
    return time.sec + 1e-9 * time.nanosec


def stamp_or_receipt_s(message, receipt_s):
    """Stamp [s] of a message; its receipt when it is not stamped, as in the original release."""
    return seconds(message.header.stamp) or receipt_s


def _add_values(message, left_out, values, key):
    """Append the values of a message to `values`, in the order of `_columns`, and to `key` what its columns depend on
    beside its type: names and lengths. This runs for every message, `_columns` once for each key.
    """
    for name in _names(type(message)):
        value = getattr(message, name)
        if type(value) in _SCALARS:  # most are
            if name != left_out:
                values.append(value)
        elif (inner := _names(type(value))) is not None:
            if name == "header":
                values += seconds(value.stamp), getattr(value, "seq", 0), value.frame_id
            elif inner == _TIME:
                values.append(seconds(value))
            else:
                _add_values(value, "", values, key)
        elif _is_binary(value):
            values.append(len(value))
            key.append(name)
        elif isinstance(value, _ARRAYS):
            key.append(len(value))
            for item in _items(value):
                if _names(type(item)) is not None:
                    own_name = getattr(item, "name", "")
                    key.append(own_name)
                    _add_values(item, "name" if own_name else "", values, key)
                else:
                    values.append(item)
        else:
            values.append(value)


def _columns(message, left_out=""):
    """Names of the values of a message, a list."""
    columns = []
    for name in _names(type(message)):
        value = getattr(message, name)
        inner = _names(type(value))
        if inner is not None and name == "header":
            columns += "stamp", "seq", "frame_id"
        elif inner is not None and inner != _TIME:
            columns += ["%s.%s" % (name, column) for column in _columns(value)]
        elif _is_binary(value):
            columns.append(name + ".bytes")
        elif isinstance(value, _ARRAYS):
            columns += _columns_of_array(name, _items(value), set(columns))
        elif name != left_out:
            columns.append(name)
    return columns


def _columns_of_array(name, items, taken):
    columns, seen = [], set()
    for index, item in enumerate(items):
        if _names(type(item)) is None:
            columns.append("%s[%d]" % (name, index))
            continue
        own_name = getattr(item, "name", "")
        label = own_name or "%s[%d]" % (name, index)
        if label in seen:
            label = "%s[%d]" % (label, index)
        seen.add(label)
        of_item = ["%s.%s" % (label, column) for column in _columns(item, "name" if own_name else "")]
        columns += of_item if taken.isdisjoint(of_item) else ["%s.%s" % (name, column) for column in of_item]
    return columns


def _is_binary(value):
    return isinstance(value, np.ndarray) and value.dtype == np.uint8 and len(value) > _MOST_NUMBERS


def _items(array):
    return array.tolist() if isinstance(array, np.ndarray) else array


@functools.cache
def _names(kind):
    """Names of the fields of a message type, without its constants (rosbags makes them class variables); None for
    other types.
    """
    if not dataclasses.is_dataclass(kind):
        return None
    return tuple(field.name for field in dataclasses.fields(kind) if not str(field.type).startswith("ClassVar"))
