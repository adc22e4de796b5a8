"""A replayed flight on the page: what is shown at a position does not depend on how it was reached."""

from __future__ import annotations

import errno
import json
import os
from math import inf
from pathlib import Path

import pytest
from pydantic import ValidationError
from recorded_flight import EPOCH_S, write_flight

from gcs_coloc.core.engine import Engine
from gcs_coloc.core.errors import DataError
from gcs_coloc.core.messages.outbound import Notice
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.mavlink.decoder import HeardTruth
from gcs_coloc.recorder.replay import Replay, replay
from gcs_coloc.recorder.tlog import TlogReader
from gcs_coloc.web.picture import fleet_frame
from gcs_coloc.web.picture_store import PictureStore
from gcs_coloc.web.playback import Playback, ReplayPass
from gcs_coloc.web.wire import PlaybackCommand, fleet_json


def replay_of(path: Path, on_poll=lambda *_: None) -> Replay:
    return Replay(Engine(load_estimator("fleet", {})), TlogReader(path), [], on_poll)


def pass_through(path: Path, truths_at=lambda _: {}) -> PictureStore:
    store = PictureStore(*TlogReader(path).span())
    ReplayPass(lambda on_poll: replay_of(path, on_poll), truths_at, store).run()
    return store


@pytest.fixture(scope="module")
def flight(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("flight") / "flight.tlog"
    write_flight(path, 20.0)
    return path


@pytest.fixture(scope="module")
def computed(flight) -> PictureStore:
    return pass_through(flight)


class Clock:
    """Time that a test passes by hand."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def seek(playback: Playback, at_s: float) -> None:
    playback.apply_command(PlaybackCommand(playing=False, seek_s=EPOCH_S + at_s))


def fleet_at(playback: Playback) -> dict:
    return json.loads(playback.messages(with_counts=False)[1])


def shown(playback: Playback) -> tuple:
    _, fleet, counts = playback.messages(with_counts=True)
    return fleet, counts, playback.events_after(0), playback.tracks()


def empty_store(pictures_s: float = 0.0) -> PictureStore:
    """100 s from 0, of which the first `pictures_s` are computed, a picture each second."""
    store = PictureStore(0.0, 100.0)
    extend(store, 0, pictures_s)
    return store


def extend(store: PictureStore, from_s: int, to_s: float) -> None:
    for at_s in range(from_s, int(to_s) + 1):
        store.add_picture(float(at_s), json.dumps({"at_s": at_s}).encode(), b"{}", None)


def test_a_picture_is_that_of_a_plain_replay_at_its_time(flight, computed):
    playback = Playback(computed, inf)
    seek(playback, 14.2)
    frames = []
    through = replay_of(flight)
    replay(through, [fleet_at(playback)["at_s"]], lambda at_s: frames.append(fleet_frame(through.engine.snapshot(at_s))))
    assert EPOCH_S + 14.0 <= frames[0].at_s <= EPOCH_S + 14.2
    plain, played = json.loads(fleet_json(frames[0])), json.loads(shown(playback)[0])
    # The alarms are those of the pass: an alarm has a past.
    assert [(a["kind"], a["state"], a["sysid"]) for a in played.pop("alarms")] == [("gps_lost", "active", 4)]
    assert plain.pop("alarms") == []
    assert played == plain
    assert '"gps_state":"failed"' in shown(playback)[0]


def test_a_position_shows_the_same_from_before_and_from_behind_and_pages_forget_what_is_later(computed):
    playback = Playback(computed, inf)
    seek(playback, 14.3)
    first, instance, edition = shown(playback), playback.instance, playback.edition
    assert playback.state.at_s == EPOCH_S + 14.3
    seek(playback, 18.0)
    assert (playback.instance, playback.edition) == (instance, edition + 1)
    assert shown(playback) != first
    seek(playback, 14.3)
    assert playback.instance != instance
    assert shown(playback) == first


def test_events_and_tracks_end_at_the_position(computed):
    playback = Playback(computed, inf)
    seek(playback, 19.0)
    late, tracks = playback.events_after(0).events, playback.tracks()
    assert any("suspect -> failed" in event.text for event in late)
    assert 17 <= len(tracks[0].at_s) <= 20
    seek(playback, 9.0)
    early = playback.events_after(0).events
    assert 0 < len(early) < len(late)
    assert early == late[: len(early)]
    assert all(event.at_s <= EPOCH_S + 9.0 for event in early)
    assert all(track.at_s[-1] <= EPOCH_S + 9.0 for track in playback.tracks())


def test_it_plays_at_its_speed_and_stops_at_the_end_and_plays_again_from_the_beginning():
    clock = Clock()
    playback = Playback(empty_store(100.0), 2.0, clock)
    places = []
    for clock.now_s in (5.0, 6.0, 7.5):
        places.append(playback.state.at_s)
    assert places == [0.0, 2.0, 5.0]
    assert fleet_at(playback)["at_s"] == 5
    playback.apply_command(PlaybackCommand(speed=0.5))
    clock.now_s = 9.5
    assert playback.state.at_s == 6.0
    playback.apply_command(PlaybackCommand(playing=False))
    clock.now_s = 60.0
    assert playback.state.at_s == 6.0
    edition = playback.edition
    playback.apply_command(PlaybackCommand(playing=True, speed="max"))
    state = playback.state
    assert (state.at_s, state.playing, state.speed) == (100.0, False, None)
    assert playback.edition == edition + 1
    instance = playback.instance
    playback.apply_command(PlaybackCommand(playing=True, speed=1.0))
    clock.now_s = 63.0
    assert (playback.state.at_s, playback.instance != instance) == (3.0, True)


def test_what_is_not_computed_in_time_is_not_caught_up_with_in_a_leap():
    clock = Clock()
    store = empty_store(10.0)
    playback = Playback(store, 50.0, clock)
    assert playback.state.at_s == 0.0
    clock.now_s = 1.0
    assert playback.state.at_s == 10.0
    extend(store, 11, 100)
    clock.now_s = 1.5
    assert playback.state.at_s == 35.0


def test_a_position_that_is_not_computed_yet_is_waited_for_with_its_progress():
    store = empty_store(10.0)
    playback = Playback(store, 1.0, Clock())
    playback.apply_command(PlaybackCommand(seek_s=40.0))
    state = playback.state
    assert (state.at_s, state.goal_s, state.computed_s, state.playing) == (10.0, 40.0, 10.0, True)
    extend(store, 11, 25)
    assert (playback.state.at_s, playback.state.computed_s, fleet_at(playback)["at_s"]) == (25.0, 25.0, 25)
    edition = playback.edition
    extend(store, 26, 50)
    state = playback.state
    assert (state.at_s, state.goal_s, state.computed_s) == (40.0, None, 50.0)
    assert playback.edition == edition + 1


def test_a_position_that_is_waited_for_is_given_up_or_replaced():
    store = empty_store(10.0)
    playback = Playback(store, 1.0, Clock())
    playback.apply_command(PlaybackCommand(seek_s=40.0))
    playback.apply_command(PlaybackCommand(halt=True))
    state = playback.state
    assert (state.at_s, state.goal_s, state.playing, state.command_count) == (10.0, None, False, 2)
    playback.apply_command(PlaybackCommand(seek_s=40.0))
    playback.apply_command(PlaybackCommand(seek_s=5.0))
    assert (playback.state.at_s, playback.state.goal_s) == (5.0, None)


def test_a_position_outside_the_recording_is_its_beginning_or_end():
    playback = Playback(empty_store(100.0), 1.0, Clock())
    for wish_s, at_s in ((500.0, 100.0), (-5.0, 0.0)):
        playback.apply_command(PlaybackCommand(seek_s=wish_s))
        assert playback.state.at_s == at_s


def test_nothing_is_sent_before_the_first_picture():
    playback = Playback(PictureStore(0.0, 100.0), 1.0, Clock())
    assert playback.messages(with_counts=True) == []
    assert (playback.tracks(), playback.newest_event, playback.utc_minus_service_s) == ((), 0, None)


def test_a_recording_that_is_cut_off_is_shown_to_its_last_whole_message_and_says_so(flight, tmp_path):
    cut = tmp_path / "cut.tlog"
    cut.write_bytes(flight.read_bytes()[: flight.stat().st_size // 4 - 3])
    playback = Playback(pass_through(cut), inf)
    seek(playback, 1.0)
    assert not [e for e in playback.events_after(0).events if "damaged" in e.text]
    seek(playback, 100.0)
    [text] = [e.text for e in playback.events_after(0).events if "damaged" in e.text]
    assert text == "the recording is damaged: truncated: 1; replayed what is whole"
    assert playback.state.at_s == playback.state.last_s < EPOCH_S + 10.0


def test_a_pass_ends_when_it_is_stopped(flight):
    store = PictureStore(*TlogReader(flight).span())
    through = ReplayPass(lambda on_poll: replay_of(flight, on_poll), lambda _: {}, store)
    through.stop()
    through.run()
    assert store.computed_s == store.first_s


def test_a_full_disk_ends_the_pass_with_the_remedy(flight, monkeypatch):
    store = PictureStore(*TlogReader(flight).span())

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(store, "add_picture", full)
    with pytest.raises(DataError, match="No space left on device; make room there, or set TMPDIR"):
        ReplayPass(lambda on_poll: replay_of(flight, on_poll), lambda _: {}, store).run()


def test_a_true_position_is_shown_while_it_is_fresh_and_only_for_its_vehicle(flight, computed):
    playback = Playback(computed, inf)
    seek(playback, 15.0)
    place = fleet_at(playback)["vehicles"][3]["snapshot"]

    def truths_at(at_s):
        return {4: HeardTruth(4, EPOCH_S + 14.5, place["lat_deg"], place["lon_deg"])} if at_s > EPOCH_S + 14.0 else {}

    playback = Playback(pass_through(flight, truths_at), inf)
    by_time = {}
    for at_s in (13.0, 15.0, 18.0):
        seek(playback, at_s)
        by_time[at_s] = [vehicle["truth_enu_m"] for vehicle in fleet_at(playback)["vehicles"]]
    assert by_time[15.0] == [None, None, None, pytest.approx(place["enu_m"], abs=1e-3)]
    assert by_time[13.0] == by_time[18.0] == [None] * 4


@pytest.mark.parametrize("bound", [{"max_pictures": 40}, {"max_bytes": 1200}])
def test_beyond_its_bound_the_store_keeps_every_second_picture_and_an_old_picture_is_still_read(bound):
    store, held, at_s = PictureStore(0.0, 100.0, **bound), None, 0.0
    while at_s <= 100.0:
        store.add_picture(at_s, json.dumps({"at_s": at_s}).encode(), b"{}", None)
        held = held or store.picture_at(20.0)
        assert len(store) <= 50
        assert store.size_bytes <= 1400
        at_s += store.picture_period_s
    assert store.picture_period_s == 3.2
    assert json.loads(held.read()[0]) == {"at_s": 0.0}
    for wish_s in range(101):
        shown_s = json.loads(store.picture_at(float(wish_s)).read()[0])["at_s"]
        assert 0.0 <= wish_s - shown_s <= 3.2 + 1e-9
    assert store.computed_s > 96.0


def test_events_that_are_left_out_are_counted():
    store = empty_store()
    for n in range(1, 701):
        store.add_event(Notice(float(n), 1, "info", str(n)))
    events = store.events(0, 600)
    assert [events.events[0].id, events.events[-1].id, events.missed] == [101, 600, 100]
    assert store.events(599, 600).events == events.events[-1:]
    assert (store.events(600, 600).events, store.events(600, 600).missed) == ((), 0)


@pytest.mark.parametrize(
    "fields", [{"speed": 0}, {"speed": "fast"}, {"speed": -1}, {"seek_s": "nan"}, {"playing": 3}, {"stop": True}, {"halt": False}]
)
def test_a_command_without_meaning_is_refused(fields):
    with pytest.raises(ValidationError):
        PlaybackCommand.model_validate(fields)


def test_a_recording_whose_clock_went_back_is_shown_to_its_end(flight, tmp_path):
    twice = tmp_path / "twice.tlog"
    twice.write_bytes(flight.read_bytes() * 2)
    once, both = (Playback(pass_through(path), inf).state.last_s - EPOCH_S for path in (flight, twice))
    assert both == pytest.approx(2.0 * once, abs=1.0)
