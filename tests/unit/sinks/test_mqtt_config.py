"""What of `[mqtt]` cannot be meant is said before the flight, in one line; a password is never shown."""

import pytest

from gcs_coloc.config.fleets import load_settings
from gcs_coloc.core.errors import ConfigError
from gcs_coloc.mavlink.refusals import Counts
from gcs_coloc.sinks.event_bus import IdleScheduler, Subscription
from gcs_coloc.sinks.mqtt import Mqtt
from gcs_coloc.sinks.mqtt_inbox import MqttHooks


def settings(**mqtt):
    return load_settings(None, {"mqtt": {"host": "broker", **mqtt}}).mqtt


def connection(**mqtt):
    def unasked(*_):
        raise AssertionError("asked before there is a connection")

    return Mqtt(
        settings(**mqtt), MqttHooks(unasked, unasked, unasked, unasked, unasked), Subscription(8), Counts(), IdleScheduler()
    )


def test_it_is_off_and_takes_nothing_unless_told():
    found = load_settings(None, {}).mqtt
    assert (found.host, found.commands, found.ranges) == ("", False, False)


@pytest.mark.parametrize(
    ("mqtt", "words"),
    [
        ({"fleet": "a/b"}, "mqtt.fleet: 'a/b' is no part of a topic"),
        ({"prefix": "#"}, "mqtt.prefix: '#' is no part of a topic"),
        ({"prefix": ""}, "mqtt.prefix"),
        ({"publish_hz": 5.1}, "mqtt.publish_hz: input should be less than or equal to 5"),
        ({"publish_hz": 0}, "mqtt.publish_hz: input should be greater than 0"),
        ({"password_file": "x"}, "mqtt: a password_file is set, but no username"),
        ({"ca_file": "x"}, "mqtt: a ca_file is set, but tls is false"),
        ({"password": "x"}, "mqtt.password: unknown key"),
    ],
)
def test_impossible_settings_are_refused(mqtt, words):
    with pytest.raises(ConfigError) as raised:
        settings(**mqtt)
    assert words in str(raised.value)


def test_files_that_cannot_be_used_are_named(tmp_path):
    with pytest.raises(ConfigError, match=r"mqtt\.password_file: .*absent: the password cannot be read: No such file"):
        connection(username="u", password_file=str(tmp_path / "absent"))
    no_text = tmp_path / "binary"
    no_text.write_bytes(b"\xff\xfe")
    no_text.chmod(0o640)
    with pytest.raises(ConfigError, match=r"mqtt\.password_file: .*can be used by others \(mode 0640\); run: chmod 600 "):
        connection(username="u", password_file=str(no_text))
    no_text.chmod(0o600)
    with pytest.raises(ConfigError, match=r"mqtt\.password_file: .*not text"):
        connection(username="u", password_file=str(no_text))
    with pytest.raises(ConfigError, match=r"mqtt\.ca_file: .*binary"):
        connection(tls=True, ca_file=str(no_text))
