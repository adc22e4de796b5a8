"""Several fleets in one configuration: what is common, what is each one's own, and what must not be shared."""

from pathlib import Path

import pytest

from gcs_coloc.cli.preflight import check_config
from gcs_coloc.config.fleets import load_fleets, load_settings
from gcs_coloc.core.errors import ConfigError, EstimatorError, UsageError
from gcs_coloc.service.service import Service

TWO = """
[aiding]
rate_hz = 8.0
lag_s = 0.15
[mqtt]
host = "broker"
[record]
directory = "flights"
[[fleet]]
name = "north"
links = ["udpin:127.0.0.1:14550"]
failed = [4]
[fleet.aiding]
lag_s = 0.3
[fleet.web]
address = "127.0.0.1:8081"
[[fleet]]
name = "south"
links = ["udpin:127.0.0.1:14551"]
[fleet.estimator]
name = "qu_zhang"
"""


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "coloc.toml"
    path.write_text(text)
    return path


def test_what_a_fleet_says_goes_before_what_is_common_to_all(tmp_path):
    north, south = load_fleets(written(tmp_path, TWO), {})
    assert (north.name, south.name) == ("north", "south")
    assert (north.settings.aiding.rate_hz, north.settings.aiding.lag_s) == (8.0, 0.3)
    assert (south.settings.aiding.rate_hz, south.settings.aiding.lag_s) == (8.0, 0.15)
    assert (north.settings.fleet.failed, south.settings.fleet.failed) == ((4,), ())
    assert (north.settings.estimator.name, south.settings.estimator.name) == ("fleet", "qu_zhang")


def test_each_fleet_has_its_own_topics_recordings_and_page(tmp_path):
    north, south = (fleet.settings for fleet in load_fleets(written(tmp_path, TWO), {}))
    assert (north.mqtt.host, north.mqtt.fleet, south.mqtt.fleet) == ("broker", "north", "south")
    assert (north.record.directory, south.record.directory) == ("flights/north", "flights/south")
    assert (north.web.on, north.web.address) == (True, "127.0.0.1:8081")
    assert not south.web.on  # it was given no address, and there is one page to an address


def test_flags_and_environment_win_over_a_fleets_own_table(tmp_path, monkeypatch):
    monkeypatch.setenv("GCS_COLOC_AIDING__LAG_S", "0.4")
    fleets = load_fleets(written(tmp_path, TWO), {"estimator": {"name": "fleet"}, "web": {"on": False}})
    assert [f.settings.aiding.lag_s for f in fleets] == [0.4, 0.4]
    assert [f.settings.estimator.name for f in fleets] == ["fleet", "fleet"]
    assert not any(f.settings.web.on for f in fleets)


def test_a_configuration_of_one_fleet_is_what_it_always_was(tmp_path):
    text = 'links = ["14550"]\n[fleet]\nfailed = [4]\n[mqtt]\nfleet = "mine"\n'
    (only,) = load_fleets(written(tmp_path, text), {})
    assert only.name == ""
    assert only.settings.model_dump() == load_settings(tmp_path / "coloc.toml", {}).model_dump()
    (only,) = load_fleets(None, {"links": ["14550"]})
    assert only.settings.model_dump() == load_settings(None, {"links": ["14550"]}).model_dump()


FLEET = '[[fleet]]\nname = "north"\nlinks = ["14550"]\n'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("fleet = []\n", ["fleet: there is none", "[[fleet]]"]),
        ('[[fleet]]\nlinks = ["14550"]\n', ["fleet 1", "name"]),
        ('[[fleet]]\nname = "a/b"\nlinks = ["14550"]\n', ["fleet 1", "name", "letters"]),
        ('[[fleet]]\nname = "north"\n', ["fleet 1 (north)", "links"]),
        (FLEET + FLEET, ["name", "north"]),
        (FLEET + FLEET.replace("north", "south"), ["links", "udpin:0.0.0.0:14550", "fleet north", "south"]),
        (
            FLEET + FLEET.replace("north", "south").replace("14550", "udpin:127.0.0.1:14550"),
            ["links", "udpin:0.0.0.0:14550 and udpin:127.0.0.1:14550 are the same place", "fleet north", "south"],
        ),
        (
            FLEET.replace("14550", "/dev/tty1:57600") + FLEET.replace("north", "south").replace("14550", "/dev/tty1:115200"),
            ["links", "same place", "fleet north", "south"],
        ),
        (
            FLEET + FLEET.replace("north", "south").replace("50", "51") + 'out = ["udp:127.0.0.1:14550"]\n',
            ["out", "udpout:127.0.0.1:14550 of fleet south", "link udpin:0.0.0.0:14550 of fleet north"],
        ),
        (FLEET + "colour = 3\n", ["fleet 1 (north)", "fleet.colour", "unknown key"]),
        (FLEET + "[fleet.aiding]\nrate_hz = -1\n", ["fleet 1 (north)", "rate_hz", "from 1 to 50"]),
        ('links = ["14550"]\n' + FLEET, ["links", "which fleet"]),
        ('out = ["127.0.0.1:14551"]\n' + FLEET, ["out", "which fleet"]),
        (
            FLEET + 'out = ["h:1"]\n' + FLEET.replace("north", "south").replace("14550", "1") + 'out = ["udp:h:1"]\n',
            ["out", "udpout:h:1", "south"],
        ),
        ('[mqtt]\nfleet = "x"\n' + FLEET, ["mqtt.fleet"]),
        (
            '[web]\naddress = "127.0.0.1:8080"\n' + FLEET + FLEET.replace("north", "south").replace("50", "51"),
            ["web.address", "fleet north", "south"],
        ),
    ],
)
def test_what_cannot_be_meant_is_refused_with_the_fleet_and_the_key(tmp_path, text, words):
    with pytest.raises(ConfigError) as refused:
        load_fleets(written(tmp_path, text), {})
    for word in words:
        assert word in str(refused.value)


@pytest.mark.parametrize(
    "flags",
    [
        {"links": ["14550"]},
        {"out": ["127.0.0.1:14551"]},
        {"fleet": {"failed": [1]}},
        {"web": {"on": True, "address": "[::1]:80"}},
    ],
)
def test_a_flag_that_is_meant_for_one_fleet_is_refused_where_there_are_several(tmp_path, flags):
    with pytest.raises(UsageError, match="several fleets"):
        load_fleets(written(tmp_path, TWO), flags)


def test_the_example_configuration_is_good():
    assert len(load_fleets(Path(__file__).resolve().parents[3] / "gcs_coloc/config/examples/fleets.toml", {})) == 2


@pytest.mark.parametrize("name", ["north", "south"])
def test_one_of_several_fleets_is_as_in_the_service(tmp_path, name):
    path = written(tmp_path, TWO)
    (same,) = [fleet.settings for fleet in load_fleets(path, {}) if fleet.name == name]
    assert load_settings(path, {}, name).model_dump() == same.model_dump()
    told = load_settings(path, {"links": ["14999"], "web": {"address": "127.0.0.1:9"}}, name)
    assert (told.links, told.web.address, told.aiding.lag_s) == (("14999",), "127.0.0.1:9", same.aiding.lag_s)


@pytest.mark.parametrize(
    ("text", "fleet", "words"),
    [
        (TWO, None, "is of several fleets .*: say which with --fleet: north, south"),
        (TWO, "east", "--fleet east: .* has no such fleet, but north, south"),
        ('links = ["14550"]', "north", r"--fleet north: .*coloc.toml has no \[\[fleet\]\]"),
        (TWO + "colour = 3", "north", "south.*colour"),
    ],
)
def test_which_fleet_is_meant_has_to_be_said_and_there_has_to_be_one(tmp_path, text, fleet, words):
    with pytest.raises(UsageError, match=words):
        load_settings(written(tmp_path, text), {}, fleet)


@pytest.mark.parametrize(
    "others",
    ["colour = 3", "[fleet.nonsense]", "[[fleet]]", "[[fleet]]\nname = 7", '[[fleet]]\nname = "north"'],
)
def test_a_worker_starts_whatever_is_wrong_with_another_fleets_table(tmp_path, others):
    path = written(tmp_path, TWO + others)
    with pytest.raises(ConfigError):
        load_fleets(path, {}, "north")
    (north,) = load_fleets(path, {}, "north", is_checked=True)
    assert north.settings.model_dump() == load_fleets(written(tmp_path, TWO), {})[0].settings.model_dump()


def test_a_fleet_that_is_no_table_is_a_mistake(tmp_path):
    for fleet in (None, "north"):
        with pytest.raises(ConfigError, match=r"coloc.toml: fleet 1: is no table; begin each fleet with \[\[fleet\]\]"):
            load_fleets(written(tmp_path, "fleet = [7]"), {}, fleet)


def test_a_fleet_without_a_file_is_a_mistake():
    with pytest.raises(UsageError, match="--fleet north: there is no --config"):
        load_settings(None, {}, "north")


def test_what_is_wrong_with_one_fleet_names_it(tmp_path):
    path = written(tmp_path, TWO.replace("qu_zhang", "qu_zang"))
    with pytest.raises(EstimatorError, match=r"^fleet south: .*qu_zang"):
        check_config(path)
    with pytest.raises(EstimatorError, match=r"^fleet south: .*qu_zang"):
        Service(load_fleets(path, {}))
    with pytest.raises(EstimatorError, match=r"^[^f]"):
        check_config(written(tmp_path, 'links = ["14550"]\n[estimator]\nname = "qu_zang"\n'))


PER_FLEET = '[service]\nprocesses = "per-fleet"\naddress = "9000"\n'


def test_with_a_process_for_each_fleet_each_has_a_page_that_the_page_of_all_leads_to(tmp_path):
    north, south = load_fleets(written(tmp_path, PER_FLEET + TWO), {})
    assert (north.settings.web.on, north.settings.web.address) == (True, "127.0.0.1:8081")
    assert (south.settings.web.on, south.settings.web.host_and_port()) == (True, ("127.0.0.1", 0))  # any free port
    assert north.settings.service.web().address == "127.0.0.1:9000"
    assert north.settings.service.web().must_open
    assert not any(f.settings.web.on for f in load_fleets(tmp_path / "coloc.toml", {"web": {"on": False}}))


def test_the_default_address_of_the_page_of_all_is_done_without_where_it_is_taken(tmp_path):
    fleets = load_fleets(written(tmp_path, '[service]\nprocesses = "per-fleet"\n' + TWO), {})
    assert not fleets[0].settings.service.web().must_open


def test_a_single_fleet_of_several_is_loaded_with_flags_of_its_own(tmp_path):
    (south,) = load_fleets(written(tmp_path, TWO), {"fleet": {"failed": [7]}, "record": {"directory": "elsewhere"}}, "south")
    assert (south.name, south.settings.fleet.failed, south.flagged) == ("south", (7,), frozenset({"failed"}))
    assert south.settings.record.directory == "elsewhere/south"
    with pytest.raises(UsageError, match=r"--fleet east: .*coloc.toml has no such fleet, but north, south"):
        load_fleets(tmp_path / "coloc.toml", {}, "east")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (PER_FLEET + 'links = ["14550"]\n', "links: unknown key"),
        ('links = ["14550"]\n' + PER_FLEET, "service.processes: per-fleet needs a table [[fleet]] for each fleet"),
        (
            PER_FLEET.replace("9000", "8081") + TWO,
            "service.address: 127.0.0.1:8081, of the page of all fleets, is given to",
        ),
        (
            FLEET + "[fleet.service]\nprocesses = 'per-fleet'\n",
            "service: is of all fleets; put [service] before the first",
        ),
        (PER_FLEET.replace("per-fleet", "many") + TWO, "service.processes: input should be 'one' or 'per-fleet'"),
    ],
)
def test_what_processes_cannot_be_is_refused(tmp_path, text, words):
    with pytest.raises(ConfigError) as error:
        load_fleets(written(tmp_path, text), {})
    assert words in str(error.value)
