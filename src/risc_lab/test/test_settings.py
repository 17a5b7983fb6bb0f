"""Settings: what a dataclass says of its fields is what a file may hold."""

import math
import subprocess
import sys
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import pytest

from risc_lab.settings import Fraction, Name, Positive, Settings, between, limits_of, settings_from


@dataclass(frozen=True)
class _Wheel(Settings):
    name: Name
    radius_m: Positive = 0.1
    spokes: between(0, 100) = 3
    life_s: float = math.inf
    marks: tuple[str, ...] = ()
    side: Literal["left", "right"] = "left"

    def __post_init__(self):
        super().__post_init__()
        if self.radius_m > 5.0:
            raise ValueError("a wheel of %g m is too large" % self.radius_m)


@dataclass(frozen=True)
class _Cart(Settings):
    wheels: tuple[_Wheel, ...]
    spare: _Wheel | None = None
    load_kg: float | None = None
    axle_m: tuple[float, float] = (0.0, 0.0)
    teeth: tuple[between(0, 9), ...] | None = None


def test_values_take_the_types_of_their_fields():
    cart = settings_from(_Cart, {"wheels": [{"name": "left", "radius_m": 1, "marks": ["a"]}]}, "cart.yaml")
    assert cart == _Cart((_Wheel("left", 1.0, 3, math.inf, ("a",)),), None)
    assert (
        _Cart((), axle_m=np.array([1.0, 2.0])[:2].tolist()).axle_m
        == _Cart((), axle_m=tuple(np.arange(1.0, 3.0))).axle_m
    )
    assert _Wheel("left", np.float64(2.0), marks=["a"]) == _Wheel("left", 2.0, marks=("a",))


@pytest.mark.parametrize(
    ("wheel", "said"),
    [
        ({"name": "left", "radius_m": -1}, r"cart.yaml: 'wheels\[0\].radius_m' .* > 0.0, found -1"),
        ({"name": "left", "radius_m": "large"}, r"'wheels\[0\].radius_m' .*number, found 'large'"),
        ({"name": "left", "radius_m": True}, "a number, found True"),
        ({"name": "left", "radius_m": math.nan}, "finite, found nan"),
        ({"name": "left", "life_s": math.inf}, "finite, found inf"),
        ({"name": "left", "spokes": 2.5}, "a whole number, found 2.5"),
        ({"name": "left", "spokes": 101}, "a whole number <= 100, found 101"),
        ({"name": ""}, "a text of length >= 1, found ''"),
        ({"name": "left", "marks": "a"}, "a list, found 'a'"),
        ({"name": "left", "side": "up"}, r"'wheels\[0\].side' .* left, right, found 'up'"),
        ({"name": "left", "radius": 1.0}, r"cart.yaml: wheels\[0\]: .* radius; .* life_s, "),
        ({"name": "left", "radius_m": 6.0}, r"cart.yaml: wheels\[0\]: a wheel of 6 m is too large"),
        ({}, r"'wheels\[0\].name' is missing"),
        (3, r"'wheels\[0\]' .*mapping, found 3"),
    ],
)
def test_what_is_wrong_is_named(wheel, said):
    with pytest.raises(ValueError, match=said):
        settings_from(_Cart, {"wheels": [wheel]}, "cart.yaml")


def test_a_whole_number_may_be_written_with_a_point():
    assert repr(settings_from(_Wheel, {"name": "left", "spokes": 3.0}).spokes) == "3"
    assert repr(settings_from(_Cart, {"wheels": [], "teeth": [3.0, 4]}).teeth) == "(3, 4)"
    assert repr(settings_from(_Cart, {"wheels": [], "load_kg": 3.0}).load_kg) == "3.0"


def test_limits_can_be_asked_for():
    @dataclass(frozen=True)
    class Slider(Settings):
        gain: Positive = 1.0
        part: Fraction = 0.5
        steps: between(1, 9) = 3
        place: float = 0.0

    anywhere = -math.inf, math.inf
    assert limits_of(Slider) == {"gain": (0.0, math.inf), "part": (0.0, 1.0), "steps": (1.0, 9.0), "place": anywhere}


def test_an_optional_value_is_named_in_words():
    with pytest.raises(ValueError, match="'load_kg' .*number or nothing, found 'much'"):
        settings_from(_Cart, {"wheels": [], "load_kg": "much"})


@dataclass(frozen=True)
class _Turn(Settings):
    psi_deg: float | Literal[""] = ""
    ways: tuple[Literal["left", "right"], ...] = ()


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"psi_deg": "x"}, "'psi_deg' .*number or empty, found 'x'"),
        ({"ways": ["left", "up"]}, r"'ways\[1\]' .*'left' or 'right', found 'up'"),
    ],
)
def test_texts_beside_other_things_are_named_too(values, text):
    with pytest.raises(ValueError, match=text):
        settings_from(_Turn, values)
    with pytest.raises(ValueError, match=text):
        _Turn(**values)
    assert settings_from(_Turn, {"psi_deg": "90"}, lenient=True).psi_deg == 90.0


@pytest.mark.parametrize("value", ["inf", "-Infinity", "nan", math.inf])
def test_a_text_is_no_way_around_finite_numbers(value):
    assert settings_from(_Wheel, {"name": "left", "life_s": "2.5"}, lenient=True).life_s == 2.5
    with pytest.raises(ValueError, match="'life_s'"):
        settings_from(_Wheel, {"name": "left", "life_s": value}, lenient=True)


def test_limits_hold_for_what_a_program_makes():
    with pytest.raises(ValueError, match="'radius_m' .* > 0.0, found -1"):
        replace(_Wheel("left"), radius_m=-1.0)


_RACE = """import sys, threading
from dataclasses import make_dataclass
from risc_lab.settings import Positive, Settings, settings_from
sys.setswitchinterval(1e-6)
for _ in range(100):
    parts = [make_dataclass("Part", [("a%d" % k, Positive) for k in range(10)], bases=(Settings,)) for _ in range(8)]
    Whole = make_dataclass("Whole", [("part%d" % k, part) for k, part in enumerate(parts)], bases=(Settings,))
    given = {"part%d" % k: {"a%d" % j: 1 for j in range(10)} for k in range(8)}
    together = threading.Barrier(6)
    def read():
        together.wait()
        settings_from(Whole, given, "")
    threads = [threading.Thread(target=read) for _ in range(6)]
    [thread.start() for thread in threads], [thread.join() for thread in threads]
"""


def test_threads_may_read_settings_of_a_class_for_the_first_time_at_once():
    """In a separate process, which used to crash: `./maap doctor` reads the same fleet in several threads."""
    assert subprocess.run([sys.executable, "-c", _RACE], check=False).returncode == 0
