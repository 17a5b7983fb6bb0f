"""./maap bench: options reach the benchmark that they belong to, and no other."""

import json
import sys

import pytest
import run

ECHO = "import json, sys; json.dump({'options': sys.argv[2:]}, open(sys.argv[1], 'w'))"


@pytest.fixture
def bench(monkeypatch, tmp_path):
    """bench(*words): (exit code, figures) of a benchmark that writes what it was given."""
    command = [sys.executable, "-c", ECHO, "{json}"]
    monkeypatch.setattr(run, "BENCHMARKS", {"a": ("one", command), "b": ("another", command)})
    file = tmp_path / "figures.json"

    def call(*words):
        monkeypatch.setattr(sys, "argv", ["maap bench", *(word.replace("FILE", str(file)) for word in words)])
        return run.main(), json.loads(file.read_text(encoding="utf-8"))

    return call


@pytest.mark.parametrize("words", [["a", "--json", "FILE", "--frames", "9", "--gate", "off"],
                                   ["a", "--frames", "9", "--json", "FILE", "--gate", "off"],
                                   ["--json", "FILE", "a", "--frames", "9", "--gate", "off"]])  # fmt: skip
def test_options_of_one_benchmark(bench, words):
    code, figures = bench(*words)
    assert code == 0 and figures["options"] == figures["a"]["options"] == ["--frames", "9", "--gate", "off"]


def test_several_have_no_options(bench, capsys):
    code, figures = bench("a", "b", "--json", "FILE")
    assert code == 0 and [figures[name]["options"] for name in ("a", "b")] == [[], []]
    for words, said in (["a", "b", "--frames", "9"], "one benchmark"), (["--frames", "9"], "unknown: 9"):
        with pytest.raises(SystemExit):
            bench(*words, "--json", "FILE")
        assert said in capsys.readouterr().err
