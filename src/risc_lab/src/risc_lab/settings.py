"""Settings as dataclasses: a class defines once each setting's name, type, limits and default.

    @dataclass(frozen=True)
    class ArrowParams(Settings):
        rate_hz: Positive = 25.0
        alpha: Fraction = 0.8
        vehicles: tuple[str, ...] = ()

    settings_from(ArrowParams, {"rate_hz": 10}, "parameters of draw_arrows")

The content of a file, of the parameter server or of a command line goes through `settings_from`, which rejects values
of the wrong type or outside their limits, and misspelt keys; fields that are dataclasses are nested mappings.
Instances that a program makes have their limits checked as well. Each problem is one ValueError that names the key.
"""

import functools
import math
import re
import threading
import typing
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass

import msgspec
import numpy as np
from msgspec import Meta

Positive = typing.Annotated[float, Meta(gt=0.0)]
NotNegative = typing.Annotated[float, Meta(ge=0.0)]
Fraction = typing.Annotated[float, Meta(ge=0.0, le=1.0)]
Count = typing.Annotated[int, Meta(ge=0)]
Port = typing.Annotated[int, Meta(ge=1, le=65535)]
Name = typing.Annotated[str, Meta(min_length=1)]
Vector = tuple[float, float, float]


def between(least, greatest):
    """Type of a number within limits, both allowed; whole numbers when the limits are."""
    return typing.Annotated[type(least), Meta(ge=least, le=greatest)]


# Two threads that let msgspec look at the same class for the first time crash the process (seen with 0.22.0).
_CONVERTING = threading.RLock()
_WORDS = {  # msgspec's names of types, in the words of a YAML file
    "float": "a number",
    "int": "a whole number",
    "str": "a text",
    "bool": "true or false",
    "array": "a list",
    "object": "a mapping",
    "null": "nothing",
}


class Settings:
    """Base of dataclasses of settings: types and limits hold also for instances that a program makes.

    A class with conditions between its fields checks them in its own __post_init__, after super().__post_init__().
    """

    def __post_init__(self):
        for key, hint in _hints(type(self)).items():
            value = _convert(getattr(self, key), hint, "", key)
            object.__setattr__(self, key, value)  # a whole number for a float, a list for a tuple


@dataclass(frozen=True)
class NoParams(Settings):
    """Settings of a member that has none."""


def settings_from(kind, values, where="", lenient=False):
    """An instance of a dataclass from a mapping. An absent key leaves the default; fields without one are required.

    where: what the values are, e.g. the path of their file; begins each error.  lenient: accept strings that hold a
    number or a truth value, and 0 and 1 for false and true.  Raises ValueError.
    """
    made = _convert(_checked(kind, values, where, ""), kind, where, strict=not lenient)
    if lenient:  # texts may have become numbers that are not finite
        _checked(kind, {key: getattr(made, key) for key in values}, where, "")
    return made


def _checked(hint, values, where, path):
    """The values, with 3 for 3.0 where a whole number is wanted.

    Raises ValueError for numbers that are not finite, and for keys that the dataclass, or a nested one, does not have.
    """
    if isinstance(values, float):
        if not math.isfinite(values):
            raise ValueError(_said(where, path, "must be finite, found %r" % values))
        return int(values) if values.is_integer() and _takes(int, hint) and not _takes(float, hint) else values
    if isinstance(values, (list, tuple)):
        return [_checked(hint, item, where, "%s[%d]" % (path, i)) for i, item in enumerate(values)]
    if typing.get_origin(hint) is typing.Literal and values not in typing.get_args(hint):
        choice = ", ".join(map(str, typing.get_args(hint)))
        raise ValueError(_said(where, path, "must be one of %s, found %r" % (choice, values)))
    if typing.get_origin(hint) is dict and isinstance(values, Mapping):
        kind = typing.get_args(hint)[1]
        values = {key: _checked(kind, value, where, "%s.%s" % (path, key)) for key, value in values.items()}
        _convert(values, hint, where, path)
        return values
    kind = next((kind for kind in (hint, *typing.get_args(hint)) if is_dataclass(kind)), None)
    if kind is not None and isinstance(values, Mapping):
        known = _hints(kind)
        unknown = sorted(str(key) for key in values if key not in known)
        if unknown:
            text = "unknown key(s) %s; known are %s" % (", ".join(unknown), ", ".join(sorted(known)))
            raise ValueError(_said(where, "", "%s%s" % (path and path.lstrip(".") + ": ", text)))
        return {key: _checked(known[key], value, where, "%s.%s" % (path, key)) for key, value in values.items()}
    return values


def _takes(kind, hint):
    """Whether a type hint is this type, or contains it."""
    return hint is kind or any(_takes(kind, part) for part in typing.get_args(hint))


def _convert(value, hint, where, key="", strict=True):
    if typing.get_origin(hint) is dict and isinstance(value, Mapping):  # msgspec would not say which item it is
        kind = typing.get_args(hint)[1]
        return {name: _convert(item, kind, where, "%s.%s" % (key, name)) for name, item in value.items()}
    try:
        with _CONVERTING:
            return msgspec.convert(_plain(value), hint, strict=strict, from_attributes=True)
    except msgspec.ValidationError as error:
        text, _, path = str(error).rpartition(" - at `$") if " - at `$" in str(error) else (str(error), "", "")
        path = path.rstrip("`")
        if isinstance(error.__cause__, ValueError):  # of a class' own __post_init__
            place = (key + path).lstrip(".")
            raise ValueError(_said(": ".join(filter(None, (where, place))), "", str(error.__cause__))) from None
        missing = re.fullmatch("Object missing required field `(.*)`", text)
        if missing:
            raise ValueError(_said(where, "%s%s.%s" % (key, path, missing[1]), "is missing")) from None
        wanted = re.sub(r"`([\w |]+)`", _in_words, text.partition(", got")[0])
        if text.startswith("Invalid enum value"):  # of a type that accepts other values besides these strings
            kinds = [part for part in typing.get_args(_hint_at(hint, path)) if part is not ...]
            wanted = "must be " + (" or ".join(map(_kind_in_words, kinds)) or "another value")
        found = ", found %r" % (_at(value, path),)
        raise ValueError(_said(where, key + path, wanted.replace("Expected", "must be") + found)) from None


def _plain(value):
    """The value with numpy's scalars replaced by Python's."""
    if isinstance(value, np.generic):
        return value.item()
    return tuple(map(_plain, value)) if isinstance(value, (tuple, list)) else value


def _in_words(types):
    """Words for a match of msgspec's `float | null`: a number or nothing."""
    return " or ".join(_WORDS.get(word, word) for word in types[1].split(" | "))


def _hint_at(hint, path):
    """The type of the field at a path, as in `_at`, of a dataclass."""
    for name in re.findall(r"\.(\w+)", path):
        kind = next((part for part in (hint, *typing.get_args(hint)) if is_dataclass(part)), None)
        hint = kind and _hints(kind).get(name)
    return hint


def _kind_in_words(hint):
    """Words for a part of `float | Literal[""]`: a number; empty."""
    if typing.get_origin(hint) is typing.Literal:
        return " or ".join("'%s'" % choice if choice else "empty" for choice in typing.get_args(hint))
    return _WORDS.get(getattr(hint, "__name__", ""), str(hint))


def _said(where, key, text):
    return ": ".join(part for part in (where, "'%s' %s" % (key.lstrip("."), text) if key else text) if part)


def _at(value, path):
    """Value at a path as msgspec writes it, e.g. ".vehicles[0].name"."""
    for name, index in re.findall(r"\.(\w+)|\[(\d+)\]", path):
        value = value[name] if name else value[int(index)]
    return value


@functools.cache
def _hints(kind):
    hints = typing.get_type_hints(kind, include_extras=True)
    return {item.name: hints[item.name] for item in fields(kind)}


def limits_of(kind):
    """{field: (least, greatest)} of a dataclass, infinite where there is none; of `Positive` the least is 0."""
    limits = {}
    for key, hint in _hints(kind).items():
        metas = [meta for meta in getattr(hint, "__metadata__", ()) if isinstance(meta, Meta)]
        least = [float(limit) for meta in metas for limit in (meta.ge, meta.gt) if limit is not None]
        greatest = [float(limit) for meta in metas for limit in (meta.le, meta.lt) if limit is not None]
        limits[key] = max(least, default=-math.inf), min(greatest, default=math.inf)
    return limits


def check_different(items, key, what):
    """Raises ValueError when two items have the same value of a field. what: the items, e.g. "vehicles"."""
    values = [getattr(item, key) for item in items]
    twice = sorted({value for value in values if values.count(value) > 1})
    if twice:
        raise ValueError("two %s have the same %s: %s" % (what, key, ", ".join(twice)))
