"""A replayed flight on the page: what is shown at a place does not depend on how it was come to, nor on the truth."""

from __future__ import annotations

import random
from math import inf
from pathlib import Path

import pytest
from pydantic import ValidationError
from recorded_flight import EPOCH_S, write_flight

from gcs_coloc.core.engine import Engine
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.mavlink.truth import HeardTruth
from gcs_coloc.recorder.checkpoints import Checkpoints
from gcs_coloc.recorder.playhead import Playhead
from gcs_coloc.recorder.replay import Replay, replay
from gcs_coloc.recorder.tlog import TlogReader
from gcs_coloc.web.picture import fleet_frame
from gcs_coloc.web.playback import Playback
from gcs_coloc.web.track_history import TrackHistory
from gcs_coloc.web.wire import PlaybackCommand, fleet_json


@pytest.fixture(scope="module")
def flight(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("flight") / "flight.tlog"
    write_flight(path, 30.0)
    return path


@pytest.fixture
def plugin(tmp_path) -> str:
    """An estimator of a researcher's own, which cannot be copied: it holds a function made within another."""
    path = tmp_path / "mine.py"
    path.write_text(
        "from gcs_coloc.estimators.fleet.filter import FleetFilter\n"
        "class Mine(FleetFilter):\n"
        "    def __init__(self):\n"
        "        super().__init__()\n"
        "        self.work = lambda: 0\n"
    )
    return f"{path}:Mine"


class Clock:
    """A second a call: every slice of work ends after one message."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        self.now_s += 1.0
        return self.now_s


Outputs = list[tuple[float, str]]


def playback_of(path: Path, estimator: str = "fleet", outputs: Outputs | None = None) -> tuple[Playback, TrackHistory]:
    """A state is kept every 300 messages; `outputs` gets what the engine puts out."""
    story = TrackHistory()

    def begin(on_poll):
        def polled(at_s, told):
            if outputs is not None:
                outputs.append((at_s, repr(told)))
            on_poll(at_s, told)

        return Replay(Engine(load_estimator(estimator, {})), TlogReader(path), [], polled)

    def keeping(beginning):
        return Checkpoints(beginning, every_s=300.0)

    return Playback(begin, Playhead(*TlogReader(path).span(), inf), story, keeping), story


def go_to(playback: Playback, at_s: float, clock) -> None:
    playback.obey(PlaybackCommand(playing=False, seek_s=EPOCH_S + at_s))
    while playback.go_on(clock) or playback.state.goal_s is not None:
        pass


def seen(playback: Playback, story: TrackHistory) -> str:
    view = playback.look()
    told = (story.counts(view).model_dump_json(), story.events_after(0).model_dump_json(), str(story.history()))
    return "".join((fleet_json(fleet_frame(view)).decode(), *told))


def test_what_is_seen_at_a_place_is_the_same_from_before_from_behind_and_in_a_plain_replay(flight):
    playback, story = playback_of(flight)
    go_to(playback, 24.3, lambda: 0.0)
    assert playback.state.at_s == EPOCH_S + 24.3
    first, instance = seen(playback, story), story.instance
    assert '"gps_state":"failed"' in first
    go_to(playback, 28.0, Clock())
    assert story.instance == instance
    assert seen(playback, story) != first
    go_to(playback, 24.3, Clock())
    assert story.instance != instance
    assert seen(playback, story) == first

    views, through = [], None

    def look(at_s):
        views.append(through.engine.snapshot(at_s))

    through = Replay(Engine(load_estimator("fleet", {})), TlogReader(flight), [], lambda *_: None)
    replay(through, [EPOCH_S + 24.3], look)
    assert playback.look().vehicles == views[0].vehicles


@pytest.mark.parametrize("estimator", ["fleet", "qu_zhang"])
def test_after_any_seeks_everything_that_is_put_out_and_seen_is_that_of_an_undisturbed_replay(flight, estimator):
    """To the last bit: the texts hold every digit of every number."""
    outputs: Outputs = []
    engine = Engine(load_estimator(estimator, {}))
    replay(Replay(engine, TlogReader(flight), [], lambda at_s, told: outputs.append((at_s, repr(told)))))
    undisturbed: dict[float, list[str]] = {}  # at one time what vehicles wait for, and then what the review of the fleet brings
    for at_s, told in outputs:
        undisturbed.setdefault(at_s, []).append(told)
    assert len(undisturbed) > 150  # of some 200 deadlines; not each has something to put out

    rng, clock = random.Random(11), Clock()
    sought: Outputs = []
    playback, story = playback_of(flight, estimator, sought)
    for place in [30.0, *(rng.uniform(0.0, 30.0) for _ in range(12)), 0.0, 30.0]:
        sought.clear()
        go_to(playback, place, clock)
        if rng.random() < 0.3:
            playback.obey(PlaybackCommand(seek_s=EPOCH_S + rng.uniform(0.0, 30.0)))
            for _ in range(40):
                playback.go_on(clock)
        assert len(sought) < 0.6 * len(outputs) or place == 30.0
        for at_s, told in sought:
            assert told in undisturbed[at_s]
    place = rng.uniform(21.0, 29.0)
    go_to(playback, place, clock)
    plain, plain_story = playback_of(flight, estimator)
    go_to(plain, place, lambda: 0.0)
    assert seen(playback, story) == seen(plain, plain_story)


def test_a_state_is_gone_on_from_instead_of_the_beginning_also_forwards(flight):
    outputs: Outputs = []
    playback, story = playback_of(flight, outputs=outputs)
    go_to(playback, 30.0, Clock())
    whole, instance = len(outputs), story.instance
    for place in (3.0, 28.0):
        outputs.clear()
        go_to(playback, place, Clock())
        assert len(outputs) < whole / 8
        assert outputs[0][0] > EPOCH_S + place - 3.0
    assert story.instance != instance
    instance, edition = story.instance, story.edition
    go_to(playback, 29.0, Clock())
    assert (story.instance, story.edition) == (instance, edition + 1)


def test_an_estimator_that_cannot_be_copied_is_replayed_from_the_beginning_and_that_is_said_once(flight, plugin, caplog):
    outputs: Outputs = []
    playback, _ = playback_of(flight, plugin, outputs)
    plain, _ = playback_of(flight, "fleet")
    for place in (24.0, 10.0, 22.0, 5.0):
        go_to(playback, place, Clock())
    go_to(plain, 5.0, lambda: 0.0)
    assert outputs[-1][0] < EPOCH_S + 5.0
    assert [at_s for at_s, _ in outputs].count(outputs[0][0]) == 3
    assert playback.look().vehicles == plain.look().vehicles
    [told] = [record.getMessage() for record in caplog.records]
    assert "estimator fleet cannot be copied (" in told
    assert "lambda" in told


def test_it_is_stopped_on_its_way_to_a_place(flight):
    playback, story = playback_of(flight)
    playback.obey(PlaybackCommand(seek_s=EPOCH_S + 25.0))
    for _ in range(300):
        playback.go_on(Clock())
    before, edition = playback.state, story.edition
    assert (before.goal_s, before.playing, before.obeyed) == (EPOCH_S + 25.0, True, 1)
    playback.obey(PlaybackCommand(halt=True))
    assert not playback.go_on(Clock())
    after = playback.state
    assert (after.goal_s, after.playing, after.obeyed) == (None, False, 2)
    assert before.at_s == after.at_s < EPOCH_S + 25.0
    assert story.edition == edition + 1


def test_it_plays_to_the_end_and_stops_there(flight):
    playback, story = playback_of(flight)
    while playback.state.playing:
        playback.go_on(Clock())
    assert story.edition == 1
    assert playback.state.at_s == playback.state.last_s == pytest.approx(EPOCH_S + 30.0, abs=0.2)
    assert {v.sysid for v in playback.look().vehicles} == {1, 2, 3, 4}
    assert playback.look().links[0].received > 300


def test_a_recording_that_is_cut_off_is_played_to_its_last_whole_message_and_says_so(flight, tmp_path):
    cut = tmp_path / "cut.tlog"
    cut.write_bytes(flight.read_bytes()[: flight.stat().st_size // 4 - 3])
    playback, story = playback_of(cut)
    for _ in range(2):
        go_to(playback, 1.0, lambda: 0.0)
        assert not [e for e in story.events_after(0).events if "damaged" in e.text]
        go_to(playback, 100.0, lambda: 0.0)
        [told] = [e.text for e in story.events_after(0).events if "damaged" in e.text]
        assert told == "the recording is damaged: truncated: 1; replayed what is whole"
    assert playback.state.at_s == playback.state.last_s < EPOCH_S + 10.0


def test_a_seek_that_is_overtaken_by_another_ends_at_the_other(flight):
    playback, _ = playback_of(flight)
    playback.obey(PlaybackCommand(playing=False, seek_s=EPOCH_S + 25.0))
    for _ in range(50):
        playback.go_on(Clock())
    go_to(playback, 5.0, Clock())
    assert playback.state.at_s == EPOCH_S + 5.0
    assert {v.gps_state for v in playback.look().vehicles} <= {"healthy", "unknown"}


@pytest.mark.parametrize(
    "words", [{"speed": 0}, {"speed": "fast"}, {"speed": -1}, {"seek_s": "nan"}, {"playing": 3}, {"stop": True}, {"halt": False}]
)
def test_what_means_nothing_is_refused(words):
    with pytest.raises(ValidationError):
        PlaybackCommand.model_validate(words)


def test_a_truth_is_drawn_while_it_is_fresh_and_only_for_its_vehicle(flight):
    playback, _ = playback_of(flight)
    go_to(playback, 20.0, lambda: 0.0)
    view = playback.look()
    place = view.vehicles[3]
    fresh = HeardTruth(4, view.at_s - 1.0, place.lat_deg, place.lon_deg)
    by_sysid = {v.view.sysid: v.truth_enu_m for v in fleet_frame(view, [fresh]).vehicles}
    assert by_sysid[4] == pytest.approx(place.enu_m, abs=1e-3)
    assert [by_sysid[sysid] for sysid in (1, 2, 3)] == [None, None, None]
    old = fresh._replace(at_s=view.at_s - 3.0)
    assert all(v.truth_enu_m is None for v in fleet_frame(view, [old]).vehicles)
