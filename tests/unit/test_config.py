"""Configuration: defaults, precedence, and errors that name the key and the mend."""

from pathlib import Path

import pytest

from gcs_coloc.cli.main import check_config
from gcs_coloc.config.fleets import load_settings
from gcs_coloc.core.engine import EngineSettings
from gcs_coloc.core.errors import ConfigError, GcsColocError


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "coloc.toml"
    path.write_text(text)
    return path


def test_the_defaults_are_the_cores_own():
    settings = load_settings(None, {})
    engine, default = settings.engine(), EngineSettings()
    for part in ("health", "feed", "aid"):
        ours, theirs = getattr(engine, part), getattr(default, part)
        assert {name: getattr(ours, name) for name in theirs.__dataclass_fields__} == {
            name: getattr(theirs, name) for name in theirs.__dataclass_fields__
        }
    assert (engine.request_streams, engine.most_vehicles) == (default.request_streams, default.most_vehicles)
    assert (settings.mavlink.system_id, settings.mavlink.component_id) == (254, 191)


def test_flags_win_over_the_environment_which_wins_over_the_file(tmp_path, monkeypatch):
    path = written(tmp_path, 'links = ["14550"]\n[aid]\nrate_hz = 8.0\nlag_s = 0.1\n[estimator]\nname = "qu_zhang"\n')
    monkeypatch.setenv("GCS_COLOC_AID__RATE_HZ", "9")
    settings = load_settings(path, {"estimator": {"name": "fleet"}})
    assert (settings.links, settings.aid.rate_hz, settings.aid.lag_s, settings.estimator.name) == (("14550",), 9.0, 0.1, "fleet")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("nonsense = 1", "nonsense: unknown key"),
        ("[health]\nfail_after = 1", "health.fail_after: unknown key"),
        ("[aid]\nrate_hz = 0", "aid: rate_hz must be a positive number, not 0"),
        ("[aid]\nrate_hz = inf", "aid: rate_hz must be a positive number, not inf"),
        ("[aid]\nlag_s = 'x'", "aid.lag_s: input should be a valid number"),
        ("[fleet]\nfailed = [300]", "fleet.failed: 300 is not a MAVLink system id"),
        ("[fleet]\nfailed = [2, 3]\nhealthy = [3]", "fleet: vehicle 3 is declared failed and healthy"),
        ("[mavlink]\nsystem_id = 0", "mavlink.system_id: input should be greater than or equal to 1"),
        ('[aid]\nway = "gps"', "aid.way: input should be 'auto'"),
        ('[aid.ways]\n300 = "gps_input"', "aid: ways: 300 is not a MAVLink system id"),
        ('[aid.ways]\n4 = "gps"', "aid.ways.4: input should be 'auto'"),
        ('[aid]\nswitch_primary = "on"', "aid.switch_primary: input should be 'off' or 'auto'"),
        ("[aid]\nprediction_s = 0", "aid: prediction_s must be a positive number, not 0"),
        ("[aid]\nrate_hz = 1000", "aid: rate_hz must be from 1 to 50, not 1000"),
        ("[aid]\nlag_s = 200", "aid: lag_s must be from 0 to 1, not 200"),
        ("[aid]\ngps_id = 2", "aid: gps_id must be from 0 to 1, not 2"),
        ("[aid]\nexternal_rate_hz = 0.01", "aid: external_rate_hz must be from 0.1 to 10, not 0.01"),
        ("[time]\ntimesync_period_s = 0.001", "time: timesync_period_s must be from 0.1 to 60, not 0.001"),
        ("[mqtt]\nranges = true", "mqtt: commands or ranges are to be taken, but no host is set"),
        ('links = "14550"', "links: must be a list, in brackets"),
        ("aid = 1", "aid: must be a table of settings, [aid]"),
        ("web = 1", "web: must be a table of settings, [web]"),
        ("links = [", "is not valid TOML"),
    ],
)
def test_errors_name_file_key_and_mend_in_one_line(tmp_path, text, words):
    with pytest.raises(ConfigError, match=r"coloc\.toml") as raised:
        load_settings(written(tmp_path, text), {})
    assert words in str(raised.value)
    assert "\n" not in str(raised.value).strip()


def test_the_way_of_a_single_vehicle_is_read_by_its_system_id(tmp_path):
    path = written(tmp_path, '[aid.ways]\n4 = "external_position"\n')
    assert load_settings(path, {}).engine().aid.ways == {4: "external_position"}


def test_a_missing_file_and_a_binary_one(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read: No such file"):
        load_settings(tmp_path / "absent.toml", {})
    binary = tmp_path / "b.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="UTF-8"):
        load_settings(binary, {})


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("GCS_COLOC_AIDD__RATE_HZ", "8", "GCS_COLOC_AIDD__RATE_HZ: there is no 'aidd' to set"),
        ("GCS_COLOC_AID__RATE", "8", "aid.rate: unknown key"),
        ("GCS_COLOC_LINKS", "14550,14551", r'"links".*lists and tables are JSON'),
        ("GCS_COLOC_FLEET__FAILED", "[4", r'"fleet".*lists and tables are JSON'),
        ("GCS_COLOC_FLEET__FAILED", "4", "fleet.failed: must be a list"),
    ],
)
def test_a_mistake_in_an_environment_variable_is_refused_as_one_in_the_file(monkeypatch, name, value, words):
    monkeypatch.setenv(name, value)
    with pytest.raises(ConfigError, match=words) as raised:
        load_settings(None, {})
    assert "\n" not in str(raised.value)


def test_a_file_that_begins_with_a_byte_order_mark_is_read(tmp_path):
    path = tmp_path / "coloc.toml"
    path.write_bytes("\ufeff[aid]\r\nrate_hz = 5.0\r\n".encode())
    assert load_settings(path, {}).aid.rate_hz == 5.0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[mqtt]\nhost = "b"\nusername = "u"\npassword_file = "absent"\n', "mqtt.password_file: absent: cannot be read"),
        ('[mqtt]\nhost = "b"\ntls = true\nca_file = "absent"\n', "mqtt.ca_file: absent: no certificates can be read from it"),
        ('[web]\ntoken_file = "absent"\n', "web.token_file: absent: cannot be read"),
        ('[web]\ntiles = "absent"\n', "web.tiles: absent: cannot be read"),
        ('[signing]\nmode = "require"\nkey_file = "absent"\n', "absent"),
    ],
)
def test_check_config_opens_every_file_that_the_configuration_names(tmp_path, monkeypatch, text, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "coloc.toml").write_text(f'links = ["udpin:127.0.0.1:14550"]\n{text}')
    with pytest.raises(GcsColocError, match=words):
        check_config(Path("coloc.toml"))


@pytest.mark.parametrize(
    ("variable", "value", "words"),
    [
        (
            "GCS_COLOC_AID__RATE_HZ",
            "abc",
            "environment variable GCS_COLOC_AID__RATE_HZ: aid.rate_hz: input should be a valid number",
        ),
        (
            "GCS_COLOC_AID__RATE_HZ",
            "1000",
            "environment variable GCS_COLOC_AID__RATE_HZ: aid: rate_hz must be from 1 to 50, not 1000",
        ),
        ("GCS_COLOC_AID", '{"lag_s": "u"}', "environment variable GCS_COLOC_AID: aid.lag_s: input should be a valid number"),
    ],
)
def test_a_wrong_value_from_the_environment_is_not_blamed_on_the_file(tmp_path, monkeypatch, variable, value, words):
    path = written(tmp_path, "[feed]\nnonsense = 1\n")
    monkeypatch.setenv(variable, value)
    with pytest.raises(ConfigError) as raised:
        load_settings(path, {})
    assert words in str(raised.value)
    assert f"{path}: feed.nonsense: unknown key" in str(raised.value)


def test_a_wrong_flag_is_not_blamed_on_the_environment(monkeypatch):
    monkeypatch.setenv("GCS_COLOC_WEB__ADDRESS", "127.0.0.1:8080")
    with pytest.raises(ConfigError, match=r"^--web: 99 is not HOST:PORT"):
        load_settings(None, {"web": {"address": "99"}})


@pytest.mark.parametrize("flag", ["failed", "healthy"])
def test_a_wrong_value_of_a_flag_is_told_with_the_flag(flag: str) -> None:
    with pytest.raises(ConfigError, match=f"^--{flag}: 300 is not a MAVLink system id"):
        load_settings(None, {"fleet": {flag: [300]}})
