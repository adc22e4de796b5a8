"""Replay: the same engine on recorded time, the same answer every time; tables beside the recording are read strictly."""

from __future__ import annotations

import random
from itertools import pairwise
from pathlib import Path

import pytest
from recorded_flight import EPOCH_S, LOST_S, write_flight

from gcs_coloc.config.settings import Settings
from gcs_coloc.core.aiding.settings import AidingSettings
from gcs_coloc.core.deadlines import advance, find_overrun
from gcs_coloc.core.engine import Engine, EngineSettings
from gcs_coloc.core.errors import DataError
from gcs_coloc.core.messages.control import ClockReference, RouteReport
from gcs_coloc.core.messages.inbound import TimeBase
from gcs_coloc.core.messages.outbound import ExternalPosition, GpsInput, HealthChanged, Notice
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.mavlink.decoder import Decoder
from gcs_coloc.mavlink.framing import OWN_COMPID, OWN_SYSID
from gcs_coloc.recorder.flight_report import FlightReport
from gcs_coloc.recorder.replay import Replay, replay
from gcs_coloc.recorder.side_channel import FlownWith, SideChannelWriter
from gcs_coloc.recorder.side_tables import TruthPoint, read_ranges, read_truth
from gcs_coloc.recorder.tlog import TlogReader, tlog_record

END_S = 24.0


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> tuple[Path, list[TruthPoint]]:
    """The fakes' four-ship, vehicle 4 without GPS after 10 s, as a tlog, and the truth of that vehicle."""
    path = tmp_path_factory.mktemp("flight") / "flight.tlog"
    return path, [point for point in write_flight(path, END_S) if point.sysid == 4]


def run(path: Path, truth: list[TruthPoint], aid: AidingSettings | None = None) -> tuple[list, FlightReport, TlogReader]:
    engine = Engine(load_estimator("fleet", {}), EngineSettings(aiding=aid if aid is not None else AidingSettings()))
    log, report, outputs = TlogReader(path), FlightReport(engine, truth), []

    def take(at_s, polled):
        outputs.extend((at_s, output) for output in polled)
        report.add_outputs(at_s, polled)

    replay(Replay(engine, log, [], take), report.observation_times(), report.observe)
    return outputs, report, log


@pytest.fixture(scope="module")
def replayed(recorded) -> tuple[list, FlightReport, TlogReader]:
    """That flight, replayed."""
    return run(*recorded)


def test_the_lost_vehicle_is_found_out_aided_and_located(replayed):
    outputs, report, _ = replayed
    changes = [o for _, o in outputs if isinstance(o, HealthChanged) and o.sysid == 4]
    assert [c.after for c in changes] == ["healthy", "suspect", "failed"]
    assert LOST_S <= changes[-1].at_s - EPOCH_S <= LOST_S + 2.0
    fixes = [(t, o) for t, o in outputs if isinstance(o, GpsInput)]
    assert {o.sysid for _, o in fixes} == {4}
    assert len(fixes) == pytest.approx(10 * (EPOCH_S + END_S - changes[-1].at_s), abs=2)
    score = report.score(4)
    assert score is not None
    assert score.share_known == 1.0
    # GPS of 1.5 m on each of three peers, correlated over minutes, is what it can be as good as; 3 sigma of that.
    assert score.horizontal is not None
    assert score.horizontal.rmse_m < 4.5
    assert score.beyond_three_bounds == 0.0
    assert report.score(1) is None


def told_and_deadlines(path: Path, **how) -> tuple[set[str], list[float]]:
    told: set[str] = set()
    times: list[float] = []

    def take(at_s, polled):
        told.update(o.text for o in polled if isinstance(o, Notice))
        times.append(at_s)

    replay(Replay(Engine(load_estimator("fleet", {})), TlogReader(path), [], take, **how))
    return told, times


def test_positions_that_go_by_another_way_are_counted_as_such(recorded):
    path, truth = recorded
    outputs, report, _ = run(path, truth, AidingSettings(method="external_position"))
    sent = sum(isinstance(o, ExternalPosition) for _, o in outputs)
    (lost,) = (v for v in report.as_dict()["vehicles"] if v["sysid"] == 4)
    assert lost["external_positions"] == sent > 5
    assert (lost["gps_input"], lost["global_positions"]) == ({"fix": 0, "no_fix": 0}, 0)


def test_whether_our_stream_is_taken_is_judged_only_where_what_is_computed_was_sent(recorded, tmp_path):
    """Vehicle 4 is located, and its GPS2 says nothing of it: as nothing was sent by another program, nor with other settings."""
    path, ours, writer = recorded[0], tmp_path / "ours.tlog", SideChannelWriter(OWN_SYSID, OWN_COMPID)
    flown_with = Settings().fingerprint()
    notes = (FlownWith(flown_with, EPOCH_S - 0.03), ClockReference(EPOCH_S, 0.0))
    ours.write_bytes(b"".join(tlog_record(note.received_at_s, writer.pack(note)) for note in notes) + path.read_bytes())
    other = Settings.model_validate({"estimator": {"name": "qu_zhang"}}).fingerprint()

    def alarms(told: set[str]) -> set[str]:
        return {text for text in told if "not taken" in text}

    told, deadlines = told_and_deadlines(ours, flown_with=flown_with)
    [alarm] = alarms(told)
    assert "GPS_INPUT is not taken" in alarm
    told, deadlines_of_other = told_and_deadlines(ours, flown_with=other)
    assert alarms(told) == set()
    assert deadlines_of_other == deadlines  # what is asked of the vehicles by its time, as TIMESYNC, is answered alike
    told, _ = told_and_deadlines(path, flown_with=flown_with)
    assert alarms(told) == set()
    assert "located: sending positions" in told


@pytest.mark.parametrize(
    "section",
    [
        {"estimator": {"settings": {"a": 1}}},
        {"aiding": {"lag_s": 0.2}},
        {"gps_health": {"silence_s": 4.0}},
        {"measurements": {"max_age_s": 4}},
    ],
)
def test_the_fingerprint_of_settings_is_another_where_the_engine_would_answer_otherwise(section):
    assert Settings.model_validate(section).fingerprint() != Settings().fingerprint()
    assert Settings.model_validate({"links": ["14550"], "web": {"on": False}}).fingerprint() == Settings().fingerprint()


def test_a_recording_cut_off_in_a_frame_replays_to_its_last_whole_message_and_says_so(recorded, replayed, tmp_path):
    path, truth = recorded
    cut = tmp_path / "cut.tlog"
    cut.write_bytes(path.read_bytes()[:-7])
    whole, _, _ = replayed
    outputs, _, log = run(cut, truth)
    assert outputs == whole[: len(outputs)]
    assert len(outputs) >= len(whole) - 3
    assert log.counts["truncated"] == 1


def test_ranges_are_read_on_the_recorders_clock(tmp_path):
    path = tmp_path / "ranges.csv"
    path.write_text("unix_s,from_sysid,to_sysid,range_m,sigma_m\n2.5,4,1,100.5,0.5\n1.5,4,2,90,\n")
    late, early = reversed(read_ranges(path))
    assert (early.measured_at_s, early.received_at_s, early.time_base) == (1.5, 1.5, TimeBase.SERVICE)
    assert (late.sysid, late.peer, late.range_m, late.sigma_m, early.sigma_m) == (4, 1, 100.5, 0.5, None)


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("x,4,1,5,1", "line 2, column 1 .unix_s.: 'x' is not a number"),
        ("1,0,1,5,1", "line 2, column 2 .from_sysid.: 0 is not within 1 to 4294967295"),
        ("1,4,4,5,1", "line 2, column 3 .to_sysid.: a vehicle has no range to itself"),
        ("1,4,1,-5,1", "line 2, column 4 .range_m.: -5 has to be above 0"),
        ("1,4,1,603730,1", "line 2, column 4 .range_m.: 603730 is beyond 100000, as in PEER_RANGE: metres are wanted"),
        ("1,4,1,5,-1", "line 2, column 5 .sigma_m.: -1 has to be above 0"),
        ("1,4,1,5", "line 2, column 5: 4 cells where the header has 5"),
    ],
)
def test_a_malformed_range_names_its_place(tmp_path, row, words):
    path = tmp_path / "ranges.csv"
    path.write_text(f"unix_s,from_sysid,to_sysid,range_m,sigma_m\n{row}\n")
    with pytest.raises(DataError, match=words):
        read_ranges(path)


@pytest.mark.parametrize(
    ("row", "words"),
    [
        (
            "1,4,149.17,-35.36,500",
            "line 2, column 3 .lat_deg.: 149.17 is not within -90 to 90: degrees are wanted, latitude before",
        ),
        ("1,4,-35.36,1491700000,500", "line 2, column 4 .lon_deg.: 1.4917e.09 is not within -180 to 360: degrees are wanted"),
    ],
)
def test_a_truth_that_is_no_place_in_degrees_is_an_error(tmp_path, row, words):
    path = tmp_path / "truth.csv"
    path.write_text(f"unix_s,sysid,lat_deg,lon_deg,alt_msl_m\n{row}\n")
    with pytest.raises(DataError, match=words):
        read_truth(path)


def test_a_column_that_is_called_nearly_like_an_optional_one_is_not_passed_over(tmp_path):
    path = tmp_path / "ranges.csv"
    path.write_text("unix_s,from_sysid,to_sysid,range_m,sigma\n1,4,1,5,1\n")
    with pytest.raises(DataError, match="column sigma_m is missing, but 'sigma' is there"):
        read_ranges(path)


def test_an_empty_truth_is_an_error(tmp_path):
    path = tmp_path / "truth.csv"
    path.write_text("unix_s,sysid,lat_deg,lon_deg,alt_msl_m\n")
    with pytest.raises(DataError, match="holds no true position"):
        read_truth(path)


def test_a_service_that_was_held_up_is_replayed_as_it_was(recorded, tmp_path):
    """Nothing comes in from 14.7 s on, it wakes for the last time at 15 s, and does nothing until all arrives at once at 18 s."""
    path, held = recorded[0], tmp_path / "held.tlog"
    engine, decoder, notes = Engine(load_estimator("fleet", {})), Decoder(), SideChannelWriter(OWN_SYSID, OWN_COMPID)
    flown, told, held_up_until_s = [], bytearray(), 0.0
    engine.receive(ClockReference(EPOCH_S, 0.0))
    told += tlog_record(EPOCH_S, notes.pack(ClockReference(EPOCH_S, 0.0)))
    for record in TlogReader(path):
        at_s = EPOCH_S + 18.0 if 14.7 < record.unix_s - EPOCH_S < 18.0 else record.unix_s
        if at_s == EPOCH_S + 18.0:
            flown.extend((t, output) for t, polled in advance(engine, EPOCH_S + 15.0) for output in polled)
        if at_s == EPOCH_S + 18.0 > held_up_until_s:
            held_up = find_overrun(engine, EPOCH_S + 15.0, at_s)
            assert held_up is not None
            held_up_until_s = held_up.until_s
            told += tlog_record(held_up.received_at_s, notes.pack(held_up))
        flown.extend((t, output) for t, polled in advance(engine, at_s, held_up_until_s) for output in polled)
        for frame in decoder.decode(record.frame, at_s):
            engine.receive(frame.message)
            if frame.is_autopilot_heartbeat:
                engine.receive(RouteReport(frame.sysid, at_s, None))
        told += tlog_record(at_s, record.frame)
    held.write_bytes(told)
    for truth in ([], recorded[1]):
        assert run(held, truth)[0] == flown
    assert [t for t, _ in flown if 14.75 < t - EPOCH_S < 15.0]
    assert not [t for t, _ in flown if 15.0 < t - EPOCH_S < 18.0]


def test_days_between_two_flights_of_one_file_are_left_out(recorded, tmp_path):
    """At five deadlines a second a year would be 160 million of them. One vehicle is enough: ten minutes are 3,000 for each."""
    path, joined = recorded[0], tmp_path / "joined.tlog"
    flight = [record for record in list(TlogReader(path))[:2000] if record.frame[5] == 1]
    year_s = 365.0 * 86400.0
    with joined.open("wb") as file:
        file.writelines(tlog_record(record.unix_s, record.frame) for record in flight)
        file.writelines(tlog_record(record.unix_s + year_s, record.frame) for record in flight)
    polled: list[float] = []
    through = Replay(Engine(load_estimator("fleet", {})), TlogReader(joined), [], lambda at_s, _: polled.append(at_s - EPOCH_S))
    replay(through)
    assert {v.sysid for v in through.engine.snapshot(through.now_s).vehicles if v.age_s < 1.0} == {1}
    [(before_s, after_s)] = [(a, b) for a, b in pairwise(polled) if b - a > 10.0]
    assert before_s == pytest.approx(flight[-1].unix_s - EPOCH_S + 600.0, abs=1.0)
    assert after_s == pytest.approx(year_s, abs=1.0)


def test_the_same_file_gives_the_same_outputs_to_the_last_bit_however_it_is_stepped_and_advanced(recorded, replayed):
    rng, outputs = random.Random(7), []
    through = Replay(
        Engine(load_estimator("fleet", {})),
        TlogReader(recorded[0]),
        [],
        lambda at_s, polled: outputs.extend((at_s, o) for o in polled),
    )
    while (next_s := through.next_s) is not None:
        if rng.random() < 0.3:
            through.advance(
                rng.uniform(through.engine.next_deadline(), next_s) if through.engine.next_deadline() < next_s else next_s
            )
        through.step()
    assert outputs == replayed[0]
