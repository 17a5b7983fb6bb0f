"""Names and sizes of landmarks are in one file; an error names the file."""

import pytest
import yaml

from risc_lab.lab.landmark_catalogue import load_landmark_catalogue
from risc_lab.lab.templates import load_templates
from risc_lab.lab.yaml_reader import package_file


def content():
    return yaml.safe_load(package_file("risc_lab", "config/landmarks.yaml").read_text(encoding="utf-8"))


def test_both_names_and_the_sizes():
    catalogue = load_landmark_catalogue()
    assert catalogue.template_of_region == {
        "green": "Green_pink",
        "pink": "Pink_blue",
        "Orange": "Orange_blue",
        "blue": "Blue_green",
    }
    assert catalogue.region_of_template["Orange_blue"] == "Orange"
    assert {load_templates()[name].kind for name in catalogue.region_of_template} == {"landmark"}
    disc = catalogue.disc("green", [1.0, 2.0, 3.0])
    assert (disc.name, disc.centre_m, disc.normal) == ("green", (1.0, 2.0, 3.0), None)
    assert (disc.diameter_m, disc.ring_diameter_m) == (0.20, 0.30)


def test_a_file_need_not_have_more_than_landmarks(tmp_path):
    short = {key: value for key, value in content().items() if key == "landmarks"}
    (tmp_path / "my.yaml").write_text(yaml.safe_dump(short))
    assert load_landmark_catalogue(tmp_path / "my.yaml").landmarks == load_landmark_catalogue().landmarks


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda c: c.pop("landmarks"), "landmarks"),
        (lambda c: c["landmarks"][1].update(name="Green_pink"), "Green_pink"),
        (lambda c: c["discs"].update(centre_diameter_m="small"), "centre_diameter_m"),
        (lambda c: c["discs"].update(ring_diameter_m=-1.0), "ring_diameter_m"),
        (lambda c: c["landmarks"][0].pop("roi_name"), "roi_name"),
    ],
)
def test_a_wrong_file_is_one_error_that_names_the_key(tmp_path, change, told):
    wrong = content()
    change(wrong)
    (tmp_path / "my.yaml").write_text(yaml.safe_dump(wrong))
    with pytest.raises(ValueError, match="my.yaml.*" + told):
        load_landmark_catalogue(tmp_path / "my.yaml")
