"""`./maap faults` and docs/faults.md know every fault."""

import pathlib
import re

import pytest

from risc_experiments.faults_list import main
from risc_lab.registry import VARIABLE
from risc_simulator.faults import REGISTRY, fault_settings

HERE = pathlib.Path(__file__).resolve().parent


def test_the_list_tells_arguments_grades_and_what_is_safe(capsys):
    assert main([]) == 0
    told = capsys.readouterr().out
    assert re.findall(r"^(\w+): ", told, re.MULTILINE) == ["ARG", *REGISTRY.names()]
    for name in REGISTRY.names():
        settings = fault_settings(name)
        part = told.partition("\n%s: %s\n" % (name, settings.summary))[2].partition("\n\n")[0]
        assert "argument  %s, " % settings.argument in part and ", ".join(settings.safe) in part
        assert all("%s %g" % grade in part for grade in settings.grades.items())


def test_one_is_told_alone_and_one_of_somebodys_own(capsys, monkeypatch):
    monkeypatch.setenv(VARIABLE, str(HERE / "members"))
    assert main(["mocap_blackout", "toy_cutout"]) == 0
    told = capsys.readouterr().out
    assert told.startswith("mocap_blackout: ") and "0 to 60 s" in told and "for 0.3 s" in told
    assert "\ntoy_cutout: " in told and "jump" not in told
    with pytest.raises(SystemExit):
        main(["fire"])
    assert "'fire'" in capsys.readouterr().err


def test_the_documentation_names_each():
    text = (HERE.parents[2] / "docs/faults.md").read_text()
    assert [name for name in REGISTRY.names() if "`%s`" % name not in text] == []
