"""What vehicles say reaches somebody, whatever kind of message it is."""

from __future__ import annotations

from dataclasses import fields, replace
from enum import Enum
from typing import Any, get_args, get_type_hints

import pytest

from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages import inbound
from gcs_coloc.core.messages.inbound import (
    Autopilot,
    EkfStatus,
    FromVehicle,
    GpsReceiver,
    Heartbeat,
    Interference,
    ReceiverIntegrity,
    SystemHealth,
)
from gcs_coloc.core.telemetry.reported_state import Telemetry
from gcs_coloc.estimators.registry import load_estimator


def _any_value(kind: Any) -> Any:
    if type(None) in get_args(kind):
        return None
    return next(iter(kind)) if issubclass(kind, Enum) else kind(1)


KINDS = [
    kind
    for kind in vars(inbound).values()
    if isinstance(kind, type) and issubclass(kind, FromVehicle) and kind is not FromVehicle
]


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_every_kind_of_message_of_a_vehicle_has_a_taker(kind):
    hints = get_type_hints(kind)
    engine = Engine(load_estimator("fleet", {}))
    engine.receive(kind(**{field.name: _any_value(hints[field.name]) for field in fields(kind)}))
    assert engine.sysids() == [1]


@pytest.mark.parametrize("own_receiver", [0, 1])
def test_the_receiver_that_we_feed_is_no_part_of_what_a_vehicle_reports_of_itself(own_receiver):
    telemetry = Telemetry(10, own_receiver)
    state = telemetry.add(1, 0.0)
    assert state is not None
    for receiver in (1 - own_receiver, own_receiver, 1 - own_receiver):
        telemetry.update(GpsReceiver(1, 1.0, receiver, 3, 47.0, 8.0, 500.0, 10, 1.0, 1.0, 1.5, 0.3))
    assert state.receiver is not None
    assert state.receiver.receiver == own_receiver


@pytest.mark.parametrize(("autopilot", "receiver"), [(Autopilot.ARDUPILOT, 0), (Autopilot.PX4, 33)])
def test_what_its_own_receiver_says_of_interference_is_kept_whatever_number_px4_gives_it(autopilot, receiver):
    telemetry = Telemetry(10, own_receiver=0)
    state = telemetry.add(1, 0.0)
    assert state is not None
    telemetry.update(Heartbeat(1, 0.0, autopilot, armed=True, winged=True))
    said = ReceiverIntegrity(1, 1.0, receiver, Interference.NONE, Interference.DETECTED, raim_failed=False)
    assert telemetry.update(said)
    assert state.integrity is said


def test_what_the_receiver_that_we_feed_says_of_interference_is_none_of_the_vehicles():
    telemetry = Telemetry(10, own_receiver=0)
    state = telemetry.add(1, 0.0)
    assert state is not None
    telemetry.update(Heartbeat(1, 0.0, Autopilot.ARDUPILOT, armed=True, winged=True))
    telemetry.update(ReceiverIntegrity(1, 1.0, 1, Interference.NONE, Interference.DETECTED, raim_failed=False))
    assert state.integrity is None


@pytest.mark.parametrize(
    ("first", "other"),
    [
        (SystemHealth(1, 1.0, True, True, True), SystemHealth(1, 1.0, True, True, False)),
        (EkfStatus(1, 1.0, True, False, False), EkfStatus(1, 1.0, True, False, True)),
    ],
    ids=["SystemHealth", "EkfStatus"],
)
def test_a_status_asks_for_a_review_at_once_only_where_it_says_something_new(first, other):
    telemetry = Telemetry(10, own_receiver=0)
    telemetry.add(1, 0.0)
    assert telemetry.update(first)
    assert not telemetry.update(replace(first, received_at_s=1.5))
    assert telemetry.update(replace(other, received_at_s=2.0))
    assert not telemetry.update(replace(other, received_at_s=2.5))
