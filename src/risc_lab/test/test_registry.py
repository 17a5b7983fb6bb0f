"""Members are found by name, in the tree and in the folders of RISC_MAAP_MEMBERS."""

import sys

import pytest

from risc_lab.lab.yaml_reader import MEMBERS_VARIABLE, config_files
from risc_lab.registry import Registry


@pytest.fixture
def registry(tmp_path, monkeypatch):
    """Registry of a package "shapes_pack.shapes" with the member "circle"; {tmp_path}/mine is a student's folder."""
    package = tmp_path / "shapes_pack" / "shapes"
    package.mkdir(parents=True)
    (package.parent / "__init__.py").touch()
    (package / "__init__.py").touch()
    (package / "_area.py").touch()
    (package / "circle.py").write_text("CORNERS = 0\n")
    (tmp_path / "mine" / "shapes").mkdir(parents=True)
    (tmp_path / "mine" / "shapes" / "square.py").write_text("CORNERS = 4\n")
    (tmp_path / "mine" / "shapes" / "square.yaml").write_text("side_m: 2.0\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delenv(MEMBERS_VARIABLE, raising=False)
    monkeypatch.setattr(
        "risc_lab.lab.yaml_reader.package_file", lambda package, path: tmp_path / package / path, raising=True
    )
    yield Registry("shapes", "shapes_pack.shapes")
    for name in [name for name in sys.modules if name.split(".")[0] == "shapes_pack"]:
        del sys.modules[name]


def test_members_of_the_tree(registry):
    assert registry.names() == ["circle"]
    assert registry.module("circle").CORNERS == 0


def test_a_member_from_elsewhere_is_a_module_of_the_same_package(registry, tmp_path, monkeypatch):
    monkeypatch.setenv(MEMBERS_VARIABLE, str(tmp_path / "mine"))
    assert registry.names() == ["circle", "square"]
    square = registry.module("square")
    assert (square.CORNERS, square.__name__) == (4, "shapes_pack.shapes.square")
    assert registry.settings("square") == {"side_m": 2.0}
    assert config_files("shapes", "shapes_pack") == {"square": tmp_path / "mine" / "shapes" / "square.yaml"}


def test_wrong_names_say_what_is_there(registry, tmp_path, monkeypatch):
    with pytest.raises(ValueError, match="'square' .*shapes; .* circle"):
        registry.module("square")
    monkeypatch.setenv(MEMBERS_VARIABLE, str(tmp_path / "nowhere"))
    with pytest.raises(ValueError, match="/nowhere"):
        registry.names()
    monkeypatch.setenv(MEMBERS_VARIABLE, str(tmp_path / "mine"))
    (tmp_path / "mine" / "shapes" / "circle.py").touch()
    with pytest.raises(ValueError, match="circle .*twice"):
        registry.names()


def test_a_yaml_file_with_the_name_of_one_of_the_tree_is_an_error(registry, tmp_path, monkeypatch):
    (tmp_path / "shapes_pack" / "config" / "shapes").mkdir(parents=True)
    (tmp_path / "shapes_pack" / "config" / "shapes" / "square.yaml").touch()
    monkeypatch.setenv(MEMBERS_VARIABLE, str(tmp_path / "mine"))
    with pytest.raises(ValueError, match="shapes: square.yaml .* RISC_MAAP_MEMBERS"):
        registry.settings("square")


@pytest.mark.parametrize("params", [None, 3, int])
def test_params_that_are_no_dataclass_are_an_error(registry, tmp_path, monkeypatch, params):
    monkeypatch.setenv(MEMBERS_VARIABLE, str(tmp_path / "mine"))
    with pytest.raises(ValueError, match="'square': .*PARAMS .*dataclass"):
        registry.settings("square", params)


@pytest.mark.parametrize("text", ["import no_such_module\n", "def broken(:\n"])
def test_a_member_that_cannot_be_imported_is_one_error_that_names_it(registry, tmp_path, monkeypatch, text):
    monkeypatch.setenv(MEMBERS_VARIABLE, str(tmp_path / "mine"))
    (tmp_path / "mine" / "shapes" / "square.py").write_text(text)
    with pytest.raises(ValueError, match="shapes: square "):
        registry.module("square")
