"""Who is aided and who is not, and what the operator's word on it does."""

from __future__ import annotations

import pytest
from engine_flights import StraightLine, aids, fly, settings

from gcs_coloc.core.engine import Engine
from gcs_coloc.core.measurements import PositionMeasurement
from gcs_coloc.core.messages import AidWord, OperatorWord


def vehicle_4(engine: Engine, now_s: float):
    return next(v for v in engine.view(now_s).vehicles if v.sysid == 4)


def test_aid_off_ends_the_stream_with_no_fix_and_auto_begins_it_again():
    engine = Engine(StraightLine(), settings())
    fly(engine, 0.0, 5.0)
    fly(engine, 5.0, 8.0, failed=[4])
    engine.receive(OperatorWord(4, 8.0, AidWord.OFF))
    stream = aids(fly(engine, 8.0, 10.0, failed=[4]), 4)
    assert [a.fix_type for _, a in stream] == [1]
    assert vehicle_4(engine, 10.0).aid == "off by the operator's word"
    engine.receive(OperatorWord(4, 10.0, AidWord.AUTO))
    assert len(aids(fly(engine, 10.0, 12.0, failed=[4]), 4)) == pytest.approx(20, abs=1)


def test_aid_on_streams_to_a_healthy_vehicle_whose_own_claims_then_count_for_nothing():
    estimator = StraightLine()
    engine = Engine(estimator, settings())
    engine.receive(OperatorWord(4, 0.0, AidWord.ON))
    out = fly(engine, 0.0, 8.0)
    assert {a.fix_type for t, a in aids(out, 4) if t > 0.5} == {3}
    assert vehicle_4(engine, 8.0).gps_state == "healthy"
    assert max((m.measured_at_s for m in estimator.of(PositionMeasurement, 4)), default=0.0) < 0.5
    assert estimator.subjects[-1][0] == {4}
    engine.receive(OperatorWord(4, 8.0, AidWord.AUTO))
    fly(engine, 8.0, 15.0)
    assert estimator.subjects[-1][0] == frozenset()
    assert max(m.measured_at_s for m in estimator.of(PositionMeasurement, 4)) > 14.5


def test_the_word_on_the_aid_leaves_the_word_on_the_gps_alone():
    engine = Engine(StraightLine(), settings())
    fly(engine, 0.0, 2.0)
    engine.receive(OperatorWord(4, 2.0, AidWord.OFF))
    seen = vehicle_4(engine, 2.0)
    assert (seen.operator_word, seen.aid_word) == ("auto", "off")
