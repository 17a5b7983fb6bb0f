"""The report of a long bag with bearings: its memory does not grow with the pictures, and little with the length."""

import pathlib
import sys

import pytest

from data_extraction.report.__main__ import make

PROGRAM = pathlib.Path(__file__).resolve().parent / "benchmarks" / "long_bag.py"
sys.path.insert(0, str(PROGRAM.parent))
from long_bag import RATE_HZ, LongBag, measure  # noqa: E402

PICTURE_PX = (320, 240)
FRAME_BYTES = 3000  # that the report may need for a frame of three vehicles while it evaluates everything
GROWTH_MB = 25.0  # what the peak may differ by from run to run, and by a few more pictures that wait


def peak_mb(folder, duration_s, picture_hz):
    """(Peak memory of the report [MB], size of the bag [MB], pictures in it)."""
    folder.mkdir()
    pictures = LongBag(folder / "long.bag").write(duration_s, picture_hz, PICTURE_PX)
    size_mb = 1e-6 * (folder / "long.bag").stat().st_size
    _, peak = measure(folder / "long.bag", folder)
    (folder / "long.bag").unlink()
    return peak, size_mb, pictures


@pytest.mark.release
def test_memory_does_not_grow_with_the_pictures(tmp_path):
    few_mb, few_size_mb, few = peak_mb(tmp_path / "few", 20.0, 2)
    many_mb, many_size_mb, many = peak_mb(tmp_path / "many", 20.0, 100)
    assert (few, many) == (40, 2000)
    assert many_size_mb - few_size_mb > 400.0, "all pictures together would be seen"
    assert many_mb - few_mb < GROWTH_MB


@pytest.mark.release
def test_memory_grows_little_with_the_length(tmp_path):
    short_mb, short_size_mb, _ = peak_mb(tmp_path / "short", 20.0, 10)
    long_mb, long_size_mb, _ = peak_mb(tmp_path / "long", 80.0, 10)
    assert long_size_mb - short_size_mb > 130.0, "all of the bag would be seen"
    assert long_mb - short_mb < GROWTH_MB + 1e-6 * 60.0 * RATE_HZ * FRAME_BYTES


def test_the_bag_is_what_it_is_meant_to_be(tmp_path):
    assert LongBag(tmp_path / "long.bag").write(12.0, 1, (64, 48)) == 12
    text = make(tmp_path / "long.bag", folder=tmp_path)[0].read_text(encoding="utf-8")
    for name in ("result", "map", "tracking", "latency", "mocap", "cameras", "bearings"):
        assert 'id="%s"' % name in text
    assert "20.0\u202fms" in text, "the vehicles are 20 ms late"
