"""The benchmark of vision: its figures, tables and pictures; and the detector's aims on a small set."""

import json
import pathlib
import subprocess
import sys

import cv2
import pytest

PROGRAM = pathlib.Path(__file__).resolve().parent / "benchmarks" / "vision.py"
sys.path.insert(0, str(PROGRAM.parent))
from vision import BEGIN, END, write_tables  # noqa: E402


def test_tables_take_their_place_in_a_document_and_nothing_else_changes(tmp_path):
    path = tmp_path / "vision.md"
    path.write_text("# Title\n\n%s\nold\n%s\n\nmore\n" % (BEGIN, END), encoding="utf-8")
    for text in ("| a |\n", "| b |\n| c |\n"):
        write_tables(text, path)
        assert path.read_text(encoding="utf-8") == "# Title\n\n%s\n%s%s\n\nmore\n" % (BEGIN, text, END)


@pytest.mark.parametrize("document", [BEGIN, END, END + BEGIN])
def test_a_document_with_one_mark_is_refused_and_stays(tmp_path, document):
    path = tmp_path / "vision.md"
    path.write_text(document, encoding="utf-8")
    with pytest.raises(ValueError, match="vision.md: "):
        write_tables("| a |\n", path)
    assert path.read_text(encoding="utf-8") == document


@pytest.mark.release
def test_a_small_run_writes_everything_and_reaches_the_aims_of_accuracy(tmp_path):
    command = [sys.executable, str(PROGRAM), "--count", "40", "--seed", "7", "--json", str(tmp_path / "figures.json")]
    command += ["--markdown", str(tmp_path / "vision.md"), "--pictures", str(tmp_path / "pictures")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    figures = json.loads((tmp_path / "figures.json").read_text(encoding="utf-8"))
    assert done.returncode in (0, 1), done.stderr
    missed = done.stderr.partition(": ")[2].strip()
    assert missed in ("", "ms_mean"), done.stderr  # speed is not tested here: the computer may be busy
    total = figures["total"]
    assert figures["pictures"] == 40
    assert figures["simulated"] is True
    assert total["wanted"] > 30
    assert total["bearing_rms_deg"] < 0.1
    assert sum(row["wanted"] for row in figures["distance"]) == total["wanted"]
    text = (tmp_path / "vision.md").read_text(encoding="utf-8")
    assert "![Found](pictures/hits.png)" in text
    assert text.strip() in done.stdout
    assert cv2.imread(str(tmp_path / "pictures" / "hits.png")) is not None
    for kind, count in figures["crops"].items():
        assert (tmp_path / "pictures" / (kind + ".png")).exists() == (count > 0)


def test_wrong_arguments_are_one_error():
    done = subprocess.run([sys.executable, str(PROGRAM), "--count", "0"], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert "--count" in done.stderr
