"""The truth of a simulation is read from its own messages, and what the engine answers is the same with and without them."""

from __future__ import annotations

import struct

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from recorded_flight import EPOCH_S, early_loss

from gcs_coloc.core.engine import Engine
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.mavlink.decoder import HeardTruth, truth_of
from gcs_coloc.mavlink.framing import read_frame
from gcs_coloc.recorder.replay import Replay, replay
from gcs_coloc.recorder.tlog import TlogReader
from sitl_fakes.fleet import Fleet

LAT_E7, LON_E7 = 473_977_420, 85_455_940
MOTION = (0.1,) * 9


def raw(message, compid: int = 1):
    frame = message.pack(mavlink.MAVLink(None, srcSystem=7, srcComponent=compid))
    return read_frame(bytes(frame), 0)


@pytest.mark.parametrize(
    "message",
    [
        mavlink.MAVLink_simstate_message(*MOTION, LAT_E7, LON_E7),
        mavlink.MAVLink_sim_state_message(1, 0, 0, 0, *MOTION, 47.4, 8.5, 500, 0, 0, 1, 2, 3, lat_int=LAT_E7, lon_int=LON_E7),
    ],
)
def test_both_messages_tell_the_place(message):
    assert truth_of(raw(message), 12.5) == HeardTruth(7, 12.5, 47.397742, 8.545594)
    assert truth_of(raw(message, compid=100), 12.5) is None


def test_what_is_no_place_and_what_is_no_truth_tells_nothing():
    assert truth_of(raw(mavlink.MAVLink_simstate_message(*MOTION, 0, 0)), 1.0) is None
    assert truth_of(raw(mavlink.MAVLink_simstate_message(*MOTION, 910_000_000, 1)), 1.0) is None
    assert truth_of(raw(mavlink.MAVLink_attitude_message(1, 0, 0, 0, 0, 0, 0)), 1.0) is None


def test_the_engine_answers_the_same_with_and_without_the_truth_on_the_wire(tmp_path):
    with_truth, without = tmp_path / "with.tlog", tmp_path / "without.tlog"
    fleet = Fleet(early_loss().model_copy(update={"truth_messages": True}), seed=3, unix_epoch_s=EPOCH_S)
    told = 0
    with with_truth.open("wb") as a, without.open("wb") as b:
        for datagram in fleet.advance(14.0):
            record = struct.pack(">Q", round((EPOCH_S + datagram.due_s) * 1e6)) + datagram.payload
            a.write(record)
            if truth_of(read_frame(datagram.payload, 0), 0.0) is None:
                b.write(record)
            else:
                told += 1
    assert told > 100
    answers = []
    for path in (with_truth, without):
        outputs = []
        engine = Engine(load_estimator("fleet", {}))
        through = Replay(engine, TlogReader(path), [], lambda *polled, told=outputs: told.append(polled))
        replay(through)
        answers.append((outputs, engine.snapshot(EPOCH_S + 14.0)))
        assert set(through.messages.truths) == ({1, 2, 3, 4} if path is with_truth else set())
    assert answers[0] == answers[1]
    assert any(v.gps_state == "failed" for v in answers[0][1].vehicles)
