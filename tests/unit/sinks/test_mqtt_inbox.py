"""What comes in over MQTT: only what is allowed, only what is possible, everything else counted."""

import json

import pytest

from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages.control import AidingOverride, GpsOverride, PrimaryOverride
from gcs_coloc.core.messages.inbound import TimeBase
from gcs_coloc.core.standby.sign_of_life import StandbyOrder
from gcs_coloc.core.stations.node_id import station_node
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.mavlink.refusals import Counts
from gcs_coloc.sinks.mqtt_inbox import MqttHooks, MqttInbox

BASE = "p/v2/f"
NOW_S = 1000.0


class Desk:
    def __init__(self, *, commands=True, ranges=True, follows=False, has_standby=False):
        self.overrides, self.ranges, self.counts, self.orders = [], [], Counts(), []
        engine = Engine(load_estimator("fleet", {}))
        hooks = MqttHooks(
            snapshot=lambda: engine.snapshot(NOW_S),
            known_sysids=lambda: [1, 4],
            apply_command=lambda sysid, override: self.overrides.append((sysid, override)),
            add_range=self.ranges.append,
            clock=lambda: NOW_S,
            command_refusal=lambda: "the other service is active" if follows else None,
            order_standby=self.order if has_standby else None,
        )
        self.inbox = MqttInbox(BASE, hooks, self.counts, commands=commands, ranges=ranges)

    def order(self, order):
        self.orders.append(order)
        return "there is nothing to take over" if order is StandbyOrder.RELEASE else None

    def take(self, tail, content, *, retained=False):
        payload = content if isinstance(content, bytes) else json.dumps(content).encode()
        self.inbox.receive(f"{BASE}/{tail}", payload, retained=retained)


KINDS = (("gps", GpsOverride), ("aiding", AidingOverride), ("gps_primary", PrimaryOverride))
OVERRIDES = [(key, override) for key, kind in KINDS for override in kind]


@pytest.mark.parametrize(("key", "override"), OVERRIDES)
def test_an_operators_override_is_applied(key, override):
    desk = Desk()
    desk.take("4/cmd", {key: override.value})
    assert desk.overrides == [(4, override)]
    assert dict(desk.counts) == {}


def test_an_override_for_a_service_that_follows_is_refused():
    desk = Desk(follows=True)
    desk.take("4/cmd", {"gps": "failed"})
    assert (desk.overrides, dict(desk.counts)) == ([], {"mqtt_cmd_to_standby": 1})


@pytest.mark.parametrize(
    ("content", "has_standby", "reasons"),
    [
        ({"order": "take_over"}, True, {}),
        ({"order": "stand_by"}, True, {}),
        ({"order": "release"}, True, {"mqtt_standby_order_refused": 1}),
        ({"order": "take_over"}, False, {"mqtt_standby_order_refused": 1}),
        ({"order": "away"}, True, {"mqtt_cmd_invalid": 1}),
        ({"gps": "failed"}, True, {"mqtt_cmd_invalid": 1}),
    ],
)
def test_an_order_on_the_hot_standby_is_carried_out_or_counted(content, has_standby, reasons):
    desk = Desk(has_standby=has_standby)
    desk.take("standby/cmd", content)
    assert dict(desk.counts) == reasons
    assert bool(desk.orders) == (has_standby and "mqtt_cmd_invalid" not in reasons)


def test_nothing_is_subscribed_or_taken_that_is_not_allowed():
    desk = Desk(commands=False, ranges=False)
    assert desk.inbox.topics == []
    desk.take("4/cmd", {"gps": "failed"})
    desk.take("4/range", {"peer": 1, "range_m": 10.0})
    assert (desk.overrides, desk.ranges, dict(desk.counts)) == ([], [], {"mqtt_topic_not_allowed": 2})
    assert Desk(ranges=False).inbox.topics == [f"{BASE}/+/cmd"]
    assert Desk(commands=False).inbox.topics == [f"{BASE}/+/range"]


@pytest.mark.parametrize(
    ("times", "measured_at_s", "base"),
    [
        ({"unix_s": 1.8e9}, 1.8e9, TimeBase.UNIX),
        ({"boot_s": 12.5}, 12.5, TimeBase.BOOT),
        ({"boot_s": 0.0}, 0.0, TimeBase.BOOT),
        ({}, None, TimeBase.SERVICE),
    ],
)
def test_a_range_reaches_the_engine_with_its_clock(times, measured_at_s, base):
    desk = Desk()
    content = {"peer": 1, "range_m": 250.5, "sigma_m": 0.4, "sequence": 7, "line_of_sight": 0.5, "device_id": 3}
    desk.take("4/range", content | times)
    (found,) = desk.ranges
    assert (found.sysid, found.peer, found.range_m, found.sigma_m) == (4, 1, 250.5, 0.4)
    assert (found.measured_at_s, found.time_base, found.received_at_s) == (measured_at_s, base, NOW_S)
    assert (found.sequence, found.line_of_sight, found.device_id) == (7, 0.5, 3)


def test_a_range_to_a_station_is_none_to_the_vehicle_of_that_number():
    desk = Desk()
    desk.take("4/range", {"station": 4, "range_m": 250.5})
    (found,) = desk.ranges
    assert (found.sysid, found.peer) == (4, station_node(4))


@pytest.mark.parametrize(
    ("tail", "content", "retained", "reason"),
    [
        ("4/cmd", {"gps": "failed"}, True, "mqtt_cmd_retained"),
        ("4/cmd", {"gps": "FAILED"}, False, "mqtt_cmd_invalid"),
        ("4/cmd", {"gps": "failed", "more": 1}, False, "mqtt_cmd_invalid"),
        ("4/cmd", {"gps": "failed", "aiding": "on"}, False, "mqtt_cmd_invalid"),
        ("4/cmd", {"aiding": "failed"}, False, "mqtt_cmd_invalid"),
        ("4/cmd", {"word": "failed"}, False, "mqtt_cmd_invalid"),
        ("4/cmd", {}, False, "mqtt_cmd_invalid"),
        ("4/cmd", b"\xff\x00", False, "mqtt_cmd_invalid"),
        ("4/cmd", b" " * 1001, False, "mqtt_cmd_too_long"),
        ("9/cmd", {"gps": "failed"}, False, "mqtt_cmd_of_unknown_vehicle"),
        ("x/cmd", {"gps": "failed"}, False, "mqtt_cmd_of_unknown_vehicle"),
        ("4/x/cmd", {"gps": "failed"}, False, "mqtt_topic_not_allowed"),
        ("4/state", {}, False, "mqtt_topic_not_allowed"),
        ("4/range", {"peer": 4, "range_m": 1.0}, False, "mqtt_range_to_itself"),
        ("4/range", {"peer": 1, "range_m": 0.0}, False, "mqtt_range_invalid"),
        ("4/range", {"peer": 1, "range_m": -5.0}, False, "mqtt_range_invalid"),
        ("4/range", {"peer": 1, "range_m": "5"}, False, "mqtt_range_invalid"),
        ("4/range", b'{"peer": 1, "range_m": NaN}', False, "mqtt_range_invalid"),
        ("4/range", b'{"peer": 1, "range_m": 1e999}', False, "mqtt_range_invalid"),
        ("4/range", {"peer": 1, "range_m": 5.0, "sigma_m": 0.0}, False, "mqtt_range_invalid"),
        ("4/range", {"peer": 4_294_967_296, "range_m": 5.0}, False, "mqtt_range_invalid"),
        ("4/range", {"range_m": 5.0}, False, "mqtt_range_invalid"),
        ("4/range", {"peer": 1, "station": 1, "range_m": 5.0}, False, "mqtt_range_invalid"),
        ("4/range", {"station": 65536, "range_m": 5.0}, False, "mqtt_range_invalid"),
        ("4/range", {"peer": 1, "range_m": 5.0, "unix_s": 5.0}, False, "mqtt_range_invalid"),
        ("4/range", {"peer": 1, "range_m": 5.0, "unix_s": 1.8e9, "boot_s": 5.0}, False, "mqtt_range_invalid"),
        ("4/range", b"[" * 900, False, "mqtt_range_invalid"),
    ],
)
def test_what_is_not_possible_is_refused_and_counted(tail, content, retained, reason):
    desk = Desk()
    desk.take(tail, content, retained=retained)
    assert (desk.overrides, desk.ranges, dict(desk.counts)) == ([], [], {reason: 1})
