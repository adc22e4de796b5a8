"""`gcs-coloc watch` refuses what makes no sense in one line that names the remedy."""

import pytest

from gcs_coloc.cli.watch import _broker, watch
from gcs_coloc.core.errors import ConfigError, UsageError


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("broker.example", {"host": "broker.example"}),
        ("broker.example:1884", {"host": "broker.example", "port": 1884}),
        ("[::1]:1884", {"host": "::1", "port": 1884}),
    ],
)
def test_the_broker_is_a_host_with_or_without_a_port(text, expected):
    assert _broker(text) == expected


@pytest.mark.parametrize("text", ["", ":1883", "host:0", "host:x", "host:70000", "host/x", "user@host", "::1"])
def test_anything_else_is_no_broker(text):
    with pytest.raises(UsageError, match="is not HOST or HOST:PORT"):
        _broker(text)


def test_without_a_broker_there_is_nothing_to_watch(tmp_path):
    config = tmp_path / "x.toml"
    config.write_text('[[fleet]]\nname = "north"\nlinks = ["14550"]\n')
    with pytest.raises(UsageError, match="--mqtt"):
        watch(config=config)


def test_what_is_wrong_in_the_used_sections_is_told_and_the_other_sections_are_left_alone(tmp_path):
    config = tmp_path / "x.toml"
    config.write_text('[mqtt]\nhots = "x"\n[aiding]\nwhatever = 1\n')
    with pytest.raises(ConfigError, match=r"mqtt\.hots") as told:
        watch(config=config)
    assert "whatever" not in str(told.value)


def test_a_password_file_that_is_not_there_is_named(tmp_path):
    config = tmp_path / "x.toml"
    config.write_text(f'[mqtt]\nhost = "x"\nusername = "u"\npassword_file = "{tmp_path / "none"}"\n')
    with pytest.raises(ConfigError, match=r"mqtt\.password_file"):
        watch(config=config, no_web=True)


def test_a_page_and_no_page_exclude_each_other():
    with pytest.raises(UsageError, match="exclude each other"):
        watch(mqtt="x", web="8081", no_web=True)
