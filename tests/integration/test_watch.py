"""`gcs-coloc watch` on two real brokers, one bridged to the other, while services and brokers are killed and come back."""

from __future__ import annotations

import contextlib
import json
import re
import subprocess
import sys
import threading
import time

import paho.mqtt.client as paho
import pytest
from brokers import PASSWORD, USER
from two_sites import two_sites
from websockets.sync.client import connect

pytestmark = pytest.mark.integration

PATIENCE_S = 60.0
NORTH, NORTH_B = "gcs-coloc/v2/north", "site-b/v2/north"


class Watching:
    """A running `gcs-coloc watch` and its newest picture."""

    def __init__(self, log, config):
        self.log = log
        with log.open("wb") as out:
            command = ["watch", "--config", str(config), "--web", "127.0.0.1:0"]
            self.process = subprocess.Popen([sys.executable, "-m", "gcs_coloc", *command], stdout=out, stderr=out)
        while not (found := re.search(r"web page: http://(\S+)/", log.read_text())):
            assert self.process.poll() is None, log.read_text()
            threading.Event().wait(0.05)
        self.stack = contextlib.ExitStack()
        self.socket = self.stack.enter_context(connect(f"ws://{found.group(1)}/live"))

    def until(self, condition):
        """The first picture on which a condition holds of the fleets by their sources."""
        deadline = time.monotonic() + PATIENCE_S
        while True:
            picture = json.loads(self.socket.recv(PATIENCE_S))
            if picture["kind"] != "fleets":
                continue
            self.socket.send("shown")
            fleets = {fleet["source"]: fleet for fleet in picture["fleets"]}
            if condition(picture, fleets):
                return picture, fleets
            assert time.monotonic() < deadline, f"waited in vain: {picture}\n{self.log.read_text()}"

    def until_presence(self, source, presence):
        return self.until(lambda _, fleets: source in fleets and fleets[source]["presence"] == presence)[1][source]

    def until_light(self, source, light):
        return self.until(lambda _, fleets: source in fleets and fleets[source]["light"] == light)[1][source]

    def end(self):
        self.stack.close()
        self.process.terminate()
        assert self.process.wait(30.0) == 0


def alarms(fleet):
    return {(alarm["sysid"], alarm["kind"]) for alarm in fleet["overview"]["alarms"]}


@pytest.fixture
def sites(tmp_path):
    with two_sites(tmp_path) as found:
        yield found


@contextlib.contextmanager
def watching(tmp_path, site):
    found = Watching(tmp_path / "watch.log", site.config)
    try:
        yield found
    finally:
        found.stack.close()
        found.process.kill()
        found.process.wait()


def test_fleets_of_two_hosts_are_live_and_one_that_dies_or_ends_is_told_at_once(sites, tmp_path):
    upper, lower = sites
    with watching(tmp_path, upper) as watch:
        for source in (NORTH, NORTH_B):
            fleet = watch.until_light(source, "good")
            assert (fleet["name"], fleet["problem"], fleet["sysids"]) == ("north", None, [1, 2, 3, 4])
        lower.failed.add(4)
        _, fleets = watch.until(lambda _, fleets: (4, "gps_lost") in alarms(fleets[NORTH_B]))
        (aided,) = [v for v in fleets[NORTH_B]["overview"]["vehicles"] if v["gps_state"] == "failed"]
        assert (aided["sysid"], aided["light"] in ("caution", "bad"), aided["lat_deg"] is not None) == (4, True, True)
        lower.kill()
        lost = watch.until_presence(NORTH_B, "lost")
        assert (lost["light"], len(lost["overview"]["vehicles"])) == ("unknown", 4)
        upper.stop()
        assert watch.until_presence(NORTH, "ended")["light"] == "unknown"
        lower.start()
        watch.until_presence(NORTH_B, "live")
        watch.end()
    with watching(tmp_path, upper) as later:  # the broker has kept what it was told last
        ended = later.until_presence(NORTH, "ended")
        assert len(ended["overview"]["vehicles"]) == 4


def test_a_bridge_that_is_lost_makes_its_fleets_stale_and_ours_stay_live(sites, tmp_path):
    upper, lower = sites
    with watching(tmp_path, upper) as watch:
        watch.until_presence(NORTH_B, "live")
        lower.broker.kill()
        stale = watch.until_presence(NORTH_B, "stale")
        assert stale["light"] == "unknown"
        watch.until_presence(NORTH, "live")
        lower.broker.start()
        watch.until_presence(NORTH_B, "live")


def test_without_the_broker_it_says_so_and_goes_on_when_that_is_back(sites, tmp_path):
    upper, _ = sites
    with watching(tmp_path, upper) as watch:
        watch.until_presence(NORTH, "live")
        watch.until_presence(NORTH_B, "live")
        upper.broker.kill()
        picture, fleets = watch.until(lambda picture, fleets: picture["problem"] and fleets[NORTH]["presence"] == "stale")
        assert str(upper.broker.port) in picture["problem"]
        assert fleets[NORTH_B]["presence"] in ("live", "stale")
        upper.broker.start()
        picture, _ = watch.until(lambda _, fleets: {f["presence"] for f in fleets.values()} == {"live"} and len(fleets) == 2)
        assert picture["problem"] is None


def test_what_is_not_ours_is_counted_and_told_and_a_deleted_fleet_goes(sites, tmp_path):
    upper, _ = sites
    with watching(tmp_path, upper) as watch:
        watch.until_presence(NORTH, "live")
        client = paho.Client(paho.CallbackAPIVersion.VERSION2)
        client.username_pw_set(USER, PASSWORD)
        client.connect("127.0.0.1", upper.broker.port)
        client.loop_start()
        wrong = (b"\xff\x00", b"{}", b'{"online": 7}', b"[" * 100_000, b"x" * 600_000)
        for payload in wrong:
            for topic in ("elsewhere/v2/x/status", "elsewhere/v2/x/overview"):
                client.publish(topic, payload, qos=1)
        picture, fleets = watch.until(lambda picture, _: sum(picture["refused"].values()) == 2 * len(wrong))
        assert picture["refused"] == {"watch_unreadable": 8, "watch_too_long": 2}
        assert "elsewhere/v2/x" not in fleets
        assert "refused: watch_unreadable" in watch.log.read_text()
        client.publish("elsewhere/v2/old/status", json.dumps({"online": False, "since_version_9": 1}), qos=1, retain=True)
        watch.until_presence("elsewhere/v2/old", "lost")
        client.publish("elsewhere/v2/old/status", b"", qos=1, retain=True)
        _, fleets = watch.until(lambda _, fleets: "elsewhere/v2/old" not in fleets)
        assert fleets[NORTH]["presence"] == "live"
        client.disconnect()
        client.loop_stop()
