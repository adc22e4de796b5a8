"""Configuration: defaults, precedence, and errors that name the key and the remedy."""

from pathlib import Path

import pytest
from tile_archive import write_archive

from gcs_coloc.cli.preflight import check_config
from gcs_coloc.config.fleets import load_settings
from gcs_coloc.config.settings import RENAMED, Settings
from gcs_coloc.core.engine import EngineSettings
from gcs_coloc.core.errors import ConfigError, GcsColocError
from gcs_coloc.core.stations.stations import Station, StationPosition


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "coloc.toml"
    path.write_text(text)
    return path


def test_the_defaults_are_the_cores_own():
    settings = load_settings(None, {})
    engine, default = settings.engine(), EngineSettings()
    for part in ("gps_health", "measurements", "aiding"):
        ours, theirs = getattr(engine, part), getattr(default, part)
        assert {name: getattr(ours, name) for name in theirs.__dataclass_fields__} == {
            name: getattr(theirs, name) for name in theirs.__dataclass_fields__
        }
    assert (engine.request_streams, engine.max_vehicles) == (default.request_streams, default.max_vehicles)
    assert (settings.mavlink.system_id, settings.mavlink.component_id) == (254, 191)


def test_flags_win_over_the_environment_which_wins_over_the_file(tmp_path, monkeypatch):
    path = written(tmp_path, 'links = ["14550"]\n[aiding]\nrate_hz = 8.0\nlag_s = 0.1\n[estimator]\nname = "qu_zhang"\n')
    monkeypatch.setenv("GCS_COLOC_AIDING__RATE_HZ", "9")
    settings = load_settings(path, {"estimator": {"name": "fleet"}})
    assert (settings.links, settings.aiding.rate_hz, settings.aiding.lag_s, settings.estimator.name) == (
        ("14550",),
        9.0,
        0.1,
        "fleet",
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("nonsense = 1", "nonsense: unknown key"),
        ("[gps_health]\nfail_after = 1", "gps_health.fail_after: unknown key"),
        ("[aiding]\nrate_hz = 0", "aiding: rate_hz must be from 1 to 50, not 0"),
        ("[aiding]\nrate_hz = inf", "aiding: rate_hz must be from 1 to 50, not inf"),
        ("[aiding]\nlag_s = 'x'", "aiding.lag_s: input should be a valid number"),
        ("[fleet]\nfailed = [300]", "fleet.failed: 300 is not a MAVLink system id"),
        ('[fleet.names]\n300 = "Kite"', "fleet.names: 300 is not a MAVLink system id"),
        ('[fleet.names]\n4 = "Black Kite"', "fleet.names.4: string should have at most 9 characters"),
        ("[fleet]\nfailed = [2, 3]\nhealthy = [3]", "fleet: vehicle 3 is declared failed and healthy"),
        ("[mavlink]\nsystem_id = 0", "mavlink.system_id: input should be greater than or equal to 1"),
        ('[aiding]\nmethod = "gps"', "aiding.method: input should be 'auto'"),
        ('[aiding.methods]\n300 = "gps_input"', "aiding: methods: 300 is not a MAVLink system id"),
        ('[aiding.methods]\n4 = "gps"', "aiding.methods.4: input should be 'auto'"),
        ('[aiding]\nswitch_primary = "on"', "aiding.switch_primary: input should be 'off' or 'auto'"),
        ("[aiding]\nprediction_s = 0", "aiding: prediction_s must be above 0, not 0"),
        (
            "[[station]]\nid = 3\nlat_deg = 91\nlon_deg = 8\nalt_m = 400",
            "station.0.lat_deg: input should be less than or equal to 90",
        ),
        ("[[station]]\nid = 3\nlat_deg = 47\nlon_deg = 8", "station.0.alt_m: field required"),
        ("[[station]]\nid = 65536\nlat_deg = 47\nlon_deg = 8\nalt_m = 400", "station.0.id: input should be less than"),
        (
            "[[station]]\nid = 3\nlat_deg = 47\nlon_deg = 8\nalt_m = 400\nsigma_m = 0",
            "station.0.sigma_m: input should be greater",
        ),
        (
            "[[station]]\nid = 3\nlat_deg = 47\nlon_deg = 8\nalt_m = 400\n" * 2,
            "station: two stations have id 3; give each its own",
        ),
        ('[measurements]\nranging_beacon_ids = "both"', "measurements.ranging_beacon_ids: input should be 'stations' or"),
        ("[aiding]\nrate_hz = 1000", "aiding: rate_hz must be from 1 to 50, not 1000"),
        ("[aiding]\nlag_s = 200", "aiding: lag_s must be from 0 to 1, not 200"),
        ("[aiding]\ngps_id = 2", "aiding: gps_id must be from 0 to 1, not 2"),
        ("[aiding]\nexternal_rate_hz = 0.01", "aiding: external_rate_hz must be from 0.1 to 10, not 0.01"),
        ("[time]\ntimesync_period_s = 0.001", "time: timesync_period_s must be from 0.1 to 60, not 0.001"),
        ("[mqtt]\nranges = true", "mqtt: commands or ranges are to be taken, but no host is set"),
        ('links = "14550"', "links: must be a list, in brackets"),
        ("aiding = 1", "aiding: must be a table of settings, [aiding]"),
        ("web = 1", "web: must be a table of settings, [web]"),
        ("[station]\nid = 3", "station: must be a table in double brackets, [[station]]"),
        ("[aiding]\nrate_hz = true", "aiding.rate_hz: must be a number, not true"),
        ("[mavlink]\nsystem_id = true", "mavlink.system_id: must be a number, not true"),
        ("[fleet]\nfailed = [4, true]", "fleet.failed.1: must be a number, not true"),
        ("[[station]]\nid = 3\nlat_deg = 47\nlon_deg = 8\nalt_m = true", "station.0.alt_m: must be a number, not true"),
        ("[measurements.range_bias_m]\n4 = false", "measurements.range_bias_m.4: must be a number, not false"),
        ("links = [", "is not valid TOML"),
        (f"[mqtt]\nport = {'9' * 5000}", "is not valid TOML: a number is too long"),
        (f"links = {'[' * 3000}", "is not valid TOML: a number is too long, or tables are nested too deep"),
    ],
)
def test_errors_name_file_key_and_remedy_in_one_line(tmp_path, text, words):
    with pytest.raises(ConfigError, match=r"coloc\.toml") as raised:
        load_settings(written(tmp_path, text), {})
    assert words in str(raised.value)
    assert "\n" not in str(raised.value).strip()


def test_the_way_of_a_single_vehicle_is_read_by_its_system_id(tmp_path):
    path = written(tmp_path, '[aiding.methods]\n4 = "external_position"\n')
    assert load_settings(path, {}).engine().aiding.methods == {4: "external_position"}


def test_the_name_of_a_vehicle_changes_no_answer_of_the_engine(tmp_path):
    named, plain = written(tmp_path, '[fleet.names]\n4 = "Kite"'), Settings()
    settings = load_settings(named, {})
    assert settings.engine().names == {4: "Kite"}
    assert settings.fingerprint() == plain.fingerprint()


def test_stations_are_read_and_decide_the_answers_of_the_engine(tmp_path):
    text = '[[station]]\nid = 3\nname = "mast"\nlat_deg = 47.1\nlon_deg = 8.2\nalt_m = 488\nsigma_m = 0.5\n'
    settings = load_settings(written(tmp_path, text), {})
    assert settings.engine().stations == (Station(3, "mast", StationPosition(47.1, 8.2, 488.0, 0.5, 0.5)),)
    moved = load_settings(written(tmp_path, text.replace("47.1", "47.2")), {})
    assert len({settings.fingerprint(), moved.fingerprint(), Settings().fingerprint()}) == 3


def test_each_fleet_may_have_stations_of_its_own(tmp_path):
    station = "[[fleet.station]]\nid = 3\nlat_deg = {lat}\nlon_deg = 8\nalt_m = 400\n"
    fleets = [
        f'[[fleet]]\nname = "{name}"\nlinks = ["{port}"]\n' + station.format(lat=lat)
        for name, port, lat in (("a", 1, 47), ("b", 2, 48))
    ]
    path = written(tmp_path, "\n".join(fleets))
    assert [load_settings(path, {}, name).station[0].lat_deg for name in "ab"] == [47.0, 48.0]


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
        ("GCS_COLOC_AIDED__RATE_HZ", "8", "GCS_COLOC_AIDED__RATE_HZ: there is no 'aided' to set"),
        ("GCS_COLOC_AIDING__RATE", "8", "aiding.rate: unknown key"),
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
    path.write_bytes("\ufeff[aiding]\r\nrate_hz = 5.0\r\n".encode())
    assert load_settings(path, {}).aiding.rate_hz == 5.0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            '[mqtt]\nhost = "b"\nusername = "u"\npassword_file = "absent"\n',
            "mqtt.password_file: absent: the password cannot",
        ),
        ('[mqtt]\nhost = "b"\ntls = true\nca_file = "absent"\n', "mqtt.ca_file: absent: no certificates can be read from it"),
        ('[web]\ntoken_file = "absent"\n', "web.token_file: absent: the operator's token cannot be read"),
        ('[web]\ntiles = "absent"\n', "web.tiles: absent: cannot be read"),
        ('[signing]\nmode = "require"\nkey_file = "absent"\n', "absent"),
    ],
)
def test_check_config_opens_every_file_that_the_configuration_names(tmp_path, monkeypatch, text, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "coloc.toml").write_text(f'links = ["udpin:127.0.0.1:14550"]\n{text}')
    with pytest.raises(GcsColocError, match=words):
        check_config(Path("coloc.toml"))


def test_the_check_leaves_no_file_open(tmp_path):
    """The supervisor of many fleets runs on after it."""
    write_archive(tmp_path / "map.pmtiles", [(0, 0, 0)])
    path = written(tmp_path, f'links = ["14550"]\n[web]\ntiles = "{tmp_path}/map.pmtiles"\n')
    check_config(path)
    assert not any(link.readlink() == tmp_path / "map.pmtiles" for link in Path("/proc/self/fd").iterdir() if link.is_symlink())


@pytest.mark.parametrize(
    ("variable", "value", "words"),
    [
        (
            "GCS_COLOC_AIDING__RATE_HZ",
            "abc",
            "environment variable GCS_COLOC_AIDING__RATE_HZ: aiding.rate_hz: input should be a valid number",
        ),
        (
            "GCS_COLOC_AIDING__RATE_HZ",
            "1000",
            "environment variable GCS_COLOC_AIDING__RATE_HZ: aiding: rate_hz must be from 1 to 50, not 1000",
        ),
        (
            "GCS_COLOC_AIDING",
            '{"lag_s": "u"}',
            "environment variable GCS_COLOC_AIDING: aiding.lag_s: input should be a valid number",
        ),
    ],
)
def test_a_wrong_value_from_the_environment_is_not_blamed_on_the_file(tmp_path, monkeypatch, variable, value, words):
    path = written(tmp_path, "[measurements]\nnonsense = 1\n")
    monkeypatch.setenv(variable, value)
    with pytest.raises(ConfigError) as raised:
        load_settings(path, {})
    assert words in str(raised.value)
    assert f"{path}: measurements.nonsense: unknown key" in str(raised.value)


def test_a_wrong_flag_is_not_blamed_on_the_environment(monkeypatch):
    monkeypatch.setenv("GCS_COLOC_WEB__ADDRESS", "127.0.0.1:8080")
    with pytest.raises(ConfigError, match=r"^--web: 99999 is not HOST:PORT"):
        load_settings(None, {"web": {"address": "99999"}})
    assert load_settings(None, {"web": {"address": "18081"}}).web.host_and_port() == ("127.0.0.1", 18081)


@pytest.mark.parametrize("flag", ["failed", "healthy"])
def test_a_wrong_value_of_a_flag_is_told_with_the_flag(flag: str) -> None:
    with pytest.raises(ConfigError, match=f"^--{flag}: 300 is not a MAVLink system id"):
        load_settings(None, {"fleet": {flag: [300]}})


def test_every_key_of_0_1_is_refused_with_its_name_of_0_2(tmp_path):
    assert RENAMED
    for old, new in RENAMED.items():
        section, _, key = old.partition(".")
        text = f"[{section}]\n{key} = 1\n" if key else f"[{section}]\n"
        with pytest.raises(ConfigError) as raised:
            load_settings(written(tmp_path, text), {})
        told = new if section in Settings.model_fields else RENAMED[section]
        assert f"is called {told} since version 0.2" in str(raised.value)
        section, _, key = new.partition(".")
        assert section in Settings.model_fields
        assert not key or key in _fields_of(section)


def _fields_of(section: str) -> frozenset[str]:
    made = getattr(Settings(), section)
    return frozenset(getattr(type(made), "model_fields", None) or type(made).__dataclass_fields__)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[aiding]\nway = "auto"', "aiding.way: is called aiding.method since version 0.2"),
        ("[measurements]\noldest_s = 1", "measurements.oldest_s: is called measurements.max_age_s since version 0.2"),
    ],
)
def test_an_old_key_in_a_renamed_section_is_told_by_its_new_name(tmp_path, text, words):
    with pytest.raises(ConfigError, match=words):
        load_settings(written(tmp_path, text), {})


def test_an_environment_variable_of_an_old_section_is_told_by_its_new_name(monkeypatch):
    monkeypatch.setenv("GCS_COLOC_AID__RATE_HZ", "8")
    with pytest.raises(ConfigError, match=r"GCS_COLOC_AID__RATE_HZ: is called GCS_COLOC_AIDING__RATE_HZ since version 0\.2"):
        load_settings(None, {})


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('peer = "192.168.1.12:14590"', ["standby", "key_file", "openssl rand"]),
        ('peer = "127.0.0.1:14590"', ["standby", "key_file"]),  # it listens on all interfaces
        ('peer = "127.elsewhere.example:14590"\nlisten = "127.0.0.1:14590"', ["standby", "key_file"]),  # a name, not an address
        ('peer = "192.168.1.12"\nkey_file = "key"', ["standby", "192.168.1.12 is not HOST:PORT"]),
        ('peer = "192.168.1.12:0"\nkey_file = "key"', ["is not HOST:PORT"]),
        ('peer = "127.0.0.1:14590"\nlisten = "here"', ["here is not HOST:PORT"]),
        ('role = "standby"', ["peer is not set"]),
        ('key_file = "key"', ["peer is not set"]),
        ('peer = "127.0.0.1:14590"\nrole = "second"', ["standby.role"]),
    ],
)
def test_a_hot_standby_that_cannot_work_is_refused(tmp_path, text, words):
    with pytest.raises(ConfigError) as refused:
        load_settings(written(tmp_path, f"[standby]\n{text}\n"), {})
    assert all(word in str(refused.value) for word in words), refused.value


def test_a_hot_standby_needs_no_key_on_loopback(tmp_path):
    text = '[standby]\npeer = "127.0.0.1:14590"\nlisten = "[::1]:14591"\n'
    standby = load_settings(written(tmp_path, text), {}).standby
    assert (standby.peer_address(), standby.listen_address()) == (("127.0.0.1", 14590), ("::1", 14591))


def test_check_config_reads_the_key_of_a_hot_standby(tmp_path):
    path = written(tmp_path, f'links = ["14550"]\n[standby]\npeer = "10.0.0.2:14590"\nkey_file = "{tmp_path}/no-key"\n')
    with pytest.raises(ConfigError, match="no-key"):
        check_config(path)
