"""docs/first_controller.md: its files are written, its controller flies offline and with the whole graph."""

import json
import os
import pathlib
import re
import shlex
import subprocess
import sys

import pytest
from flying import fly

ROOT = pathlib.Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "first_controller.md").read_text(encoding="utf-8")
FILES = dict(re.findall(r"`(my_lab/[\w/.]+)`:\n\n```\w+\n(.*?)```", PAGE, re.DOTALL))
COMMANDS = [line for block in re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL) for line in block.splitlines()]
LIMIT_M = 0.06  # twice the level's spread, 0.01 rad, is 0.05 m at the page's spring


@pytest.fixture
def reader(tmp_path, monkeypatch):
    """A folder with the files of the page, and the environment that the page sets in it."""
    for name, content in FILES.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content, encoding="utf-8")
    name, value = re.search(r"^export (\w+)=\$PWD/(\w+)$", "\n".join(COMMANDS), re.MULTILINE).groups()
    monkeypatch.setenv(name, str(tmp_path / value))
    return tmp_path


def test_the_controller_of_the_page_flies_offline(reader):
    (command,) = [line for line in COMMANDS if "risc_experiments.offline" in line]
    shell, option, python = shlex.split(command)[1:]
    assert (shell, option) == ("shell", "-c")
    figures = reader / "figures.json"
    program, *arguments = shlex.split(python)
    assert program == "python3"
    subprocess.run([sys.executable, *arguments, "--json", str(figures)], cwd=str(reader), env=os.environ, check=True)
    flights = json.loads(figures.read_text())["flights"]
    assert flights and all(0.0 < rmse_m < LIMIT_M for flight in flights for rmse_m in flight["rmse_m"])


@pytest.mark.alone
def test_the_controller_of_the_page_flies_with_the_whole_graph(reader):
    (command,) = [line for line in COMMANDS if line.startswith("./maap fly")]
    code, output, summary, _ = fly(reader / "flight", *shlex.split(command)[2:], "--duration", "10")
    assert code == 0, output
    (vehicle,) = summary["vehicles"].values()
    assert 0.0 < vehicle["position_rmse_m"] < LIMIT_M
