"""Configuration: keys, values, texts, ids, and the aircraft's store of profiles."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ardrone_autonomy import aircraft_configuration
from ardrone_autonomy.protocol import config
from ardrone_autonomy.protocol.config import Category, ConfigError
from risc_simulator.vehicles.ardrone.profiles import MAX_PROFILES, ConfigurationStore

SESSION, USER, APPLICATION = "00aabbcc", "cea48d22", "e182b69b"
IDS = (SESSION, USER, APPLICATION)


def test_ids_of_the_ros_driver():
    assert (aircraft_configuration.USER_ID, aircraft_configuration.APPLICATION_ID) == ("cea48d22", "e182b69b")
    assert config.crc_id("123456789") == "cbf43926"  # the check value of CRC-32
    assert config.is_id("cea48d22") and not config.is_id("CEA48D22") and not config.is_id("-cea48d2")


@pytest.mark.parametrize(
    "full, kind, default, category",
    [
        ("control:outdoor", bool, False, Category.COMMON),
        ("control:altitude_max", int, 3000, Category.COMMON),
        ("control:altitude_min", int, 50, Category.COMMON),
        ("control:euler_angle_max", float, 0.209440, Category.USER),
        ("control:control_vz_max", float, 700.0, Category.USER),
        ("control:control_yaw", float, 1.745329, Category.USER),
        ("control:outdoor_control_yaw", float, 3.490659, Category.USER),
        ("detect:detect_type", int, 3, Category.SESSION),
        ("detect:detections_select_h", int, 0, Category.SESSION),
        ("detect:enemy_colors", int, 1, Category.COMMON),
        ("general:navdata_demo", bool, False, Category.COMMON),
        ("general:navdata_options", int, 65537, Category.APPLICATION),
        ("video:video_codec", int, 129, Category.SESSION),
        ("leds:leds_anim", str, "0,0,0", Category.COMMON),
    ],
)
def test_keys(full, kind, default, category):
    key = config.KEYS[full]
    assert (key.key, key.kind, key.default, key.category, key.read_only) == (full, kind, default, category, False)


def test_every_name_is_unique_and_the_thesis_misspelling_is_no_key():
    names = [key.name for key in config.KEYS.values()]  # the parameters of the driver use the bare names
    assert len(names) == len(set(names))
    assert "detections" not in names
    assert config.KEYS["general:num_version_soft"].read_only


@pytest.mark.parametrize(
    "kind, value, text",
    [
        (bool, True, "TRUE"),
        (bool, False, "FALSE"),
        (int, 129, "129"),
        (int, 3000.0, "3000"),
        (float, 0.349066, "0.349066"),
        (float, 1000, "1000.000000"),
        (str, "3,20", "3,20"),
        (tuple, (1.5, -2.0), "{ 1.5000000e+00 -2.0000000e+00 }"),
    ],
)
def test_values_both_ways(kind, value, text):
    assert config.format_value(kind, value) == text
    assert config.parse_value(kind, text) == value


@pytest.mark.parametrize(
    "kind, text, value",
    [
        (bool, "true", True),
        (bool, "1", True),
        (bool, "0", False),
        (int, " 7 ", 7),
        (int, "3000.000000", 3000),
        (float, "1", 1.0),
    ],
)
def test_values_tolerated(kind, text, value):
    assert config.parse_value(kind, text) == value


@pytest.mark.parametrize(
    "kind, text",
    [
        (bool, "maybe"),
        (int, "x"),
        (int, "inf"),
        (int, "nan"),
        (float, "nan"),
        (float, ""),
        (float, "1e999"),
        (tuple, "{ a }"),
        (str, "a\nb"),
        (str, "a\0b"),
    ],
)
def test_values_refused(kind, text):
    with pytest.raises(ConfigError):
        config.parse_value(kind, text)


def test_values_that_cannot_be_written():
    for kind, value in (
        (int, "x"),
        (int, float("nan")),
        (float, float("inf")),
        (float, None),
        (tuple, 3),
    ):
        with pytest.raises(ConfigError):
            config.format_value(kind, value)


def config_lines(data):
    """{key: text} of a readback, read without the codec."""
    assert data.endswith(b"\n\0")
    return dict(line.split(" = ", 1) for line in data[:-2].decode("ascii").split("\n"))


def id_lines(data):
    """{section: {id: description}} of a list of ids, read without the codec."""
    assert data.endswith(b"\r\0")
    sections = {}
    for line in data[:-2].decode("ascii").split("\r"):
        if line.startswith("["):
            identities = sections[line[1:-1]] = {}
        else:
            identity, description = line.split(",", 1)
            identities[identity] = description
    return sections


def test_config_text():
    values = {"general:num_version_soft": "2.4.8", "general:ardrone_name": "dr\u00f6ne", "video:video_on_usb": "TRUE"}
    assert config.encode_config_text(values) == (
        b"general:num_version_soft = 2.4.8\ngeneral:ardrone_name = dr?ne\nvideo:video_on_usb = TRUE\n\0"
    )


def test_custom_ids_text():
    data = config.encode_custom_ids({APPLICATION: "driver"}, {USER: "me", "00000000": "default"}, {})
    assert data == b"[common]\r[applis]\re182b69b,driver\r[profiles]\rcea48d22,me\r00000000,default\r[sessions]\r\0"


@given(
    st.sampled_from(sorted(config.KEYS) + ["no:key"]),
    st.one_of(st.text(max_size=30), st.text(alphabet="{}\0\r\n =:a1-,", max_size=12)),
    st.one_of(st.none(), st.tuples(*[st.sampled_from(["00000000", USER, "-all", "x"])] * 3)),
)
def test_store_never_raises_and_can_always_be_read_back(key, text, ids):
    store = ConfigurationStore()
    store.write(key, text, ids)
    store.write("custom:profile_id", text, ids)
    assert list(config_lines(store.text())) == list(config.KEYS)
    assert list(id_lines(store.custom_ids_text())) == ["common", "applis", "profiles", "sessions"]


# ------------------------------------------------------------------ on the aircraft


def use(store, ids=IDS):
    for key, identity in zip(("custom:session_id", "custom:profile_id", "custom:application_id"), ids):
        assert store.write(key, identity, ids)


def test_defaults_and_common_writes():
    store = ConfigurationStore(serial="PS1")
    assert store.get("general:drone_serial") == "PS1"
    assert store.get("control:altitude_max") == 3000
    assert store.write("control:altitude_max", "2000") and store.get("control:altitude_max") == 2000
    assert store.write("CONTROL:altitude_max", "1e9") and store.get("control:altitude_max") == 100000


@pytest.mark.parametrize(
    "key, text",
    [
        ("general:num_version_soft", "9"),
        ("no:key", "1"),
        ("detections", "3"),
        ("control:altitude_max", "high"),
        ("custom:session_id", "xyz"),
        ("custom:session_id", "-12345678"),
        ("custom:session_id", "-00000000"),
    ],
)
def test_writes_that_are_ignored(key, text):
    store = ConfigurationStore()
    before = store.text()
    assert not store.write(key, text, ("00000000",) * 3)
    assert store.text() == before


def test_profiles_keep_their_own_values():
    store = ConfigurationStore()
    use(store)
    assert store.current_ids == IDS
    assert store.write("control:euler_angle_max", "0.35", IDS)
    assert store.write("detect:detect_type", "10", IDS)
    assert store.get("control:euler_angle_max") == 0.35
    store.write("custom:profile_id", "00000000", IDS)
    assert store.get("control:euler_angle_max") == 0.209440
    assert store.get("detect:detect_type") == 10
    store.write("custom:profile_id", USER, IDS)
    assert store.get("control:euler_angle_max") == 0.35


def test_a_write_with_other_ids_is_ignored_unless_the_key_is_common():
    store = ConfigurationStore()
    use(store)
    other = (SESSION, "11111111", APPLICATION)
    assert not store.write("control:euler_angle_max", "0.1", other)
    assert store.get("control:euler_angle_max") == 0.209440
    assert store.write("control:altitude_max", "1000", other)


def test_without_ids_the_default_profile_is_written():
    store = ConfigurationStore()
    assert store.write("control:euler_angle_max", "0.3")
    assert store.get("control:euler_angle_max") == 0.3
    use(store)
    assert store.get("control:euler_angle_max") == 0.209440
    assert store.write("control:euler_angle_max", "0.4")  # a client that does not use ids
    assert store.get("control:euler_angle_max") == 0.209440
    store.write("custom:profile_id", "00000000", IDS)
    assert store.get("control:euler_angle_max") == 0.4


def test_deleting_profiles():
    store = ConfigurationStore()
    use(store)
    store.write("custom:profile_desc", "ardrone_driver", IDS)
    store.write("control:euler_angle_max", "0.35", IDS)
    ids = id_lines(store.custom_ids_text())
    assert ids["profiles"][USER] == "ardrone_driver" and SESSION in ids["sessions"]
    assert store.write("custom:profile_id", "-" + USER, IDS)
    assert store.get("custom:profile_id") == "00000000"
    store.write("custom:profile_id", USER, IDS)
    assert store.get("control:euler_angle_max") == 0.209440  # it was forgotten
    assert store.write("custom:session_id", "-all")
    assert store.current_ids[0] == "00000000"
    assert list(id_lines(store.custom_ids_text())["sessions"]) == ["00000000"]


def test_outdoor_switch_copies_the_limits_and_limits_update_their_twin():
    store = ConfigurationStore()
    use(store)
    store.write("control:outdoor", "TRUE", IDS)
    assert [store.get("control:" + n) for n in config.FLIGHT_LIMITS] == [0.349066, 1000.0, 3.490659]
    store.write("control:control_yaw", "2.0", IDS)
    assert store.get("control:outdoor_control_yaw") == 2.0
    assert store.get("control:indoor_control_yaw") == 1.745329
    store.write("control:outdoor", "FALSE", IDS)
    assert [store.get("control:" + n) for n in config.FLIGHT_LIMITS] == [0.209440, 700.0, 1.745329]
    store.write("control:outdoor", "TRUE", IDS)
    assert store.get("control:control_yaw") == 2.0


def test_readback_lists_every_key():
    values = config_lines(ConfigurationStore().text())
    assert list(values) == list(config.KEYS)
    assert values["control:euler_angle_max"] == "0.209440"
    assert values["general:num_version_config"] == "1"
    assert values["general:navdata_demo"] == "FALSE"
    assert values["control:accs_offset"].startswith("{ ")


def test_profiles_do_not_become_ever_more():
    store = ConfigurationStore()
    for number in range(1000):
        store.write("custom:session_id", "%08x" % (number + 1))
    assert len(store._profiles[Category.SESSION]) == MAX_PROFILES
    assert store.write("custom:session_id", "%08x" % 1)  # one that is known
