"""Observers who want a snapshot within a moment of each other share one; what is recorded is one, too."""

from __future__ import annotations

import pytest
from engine_flights import StraightLine, fly, settings

from gcs_coloc.config.sections import SigningConfig
from gcs_coloc.config.settings import Settings
from gcs_coloc.core.engine import Engine
from gcs_coloc.links.forward import Forwarder
from gcs_coloc.links.routes import RouteTable
from gcs_coloc.links.signed_links import SignedLinks
from gcs_coloc.mavlink.decoder import SequenceTracker
from gcs_coloc.mavlink.refusals import Counts, Refusal, Refusals
from gcs_coloc.recorder.flight_recording import FlightRecording
from gcs_coloc.service.fleet_views import SnapshotCache


class HandMoved:
    """A clock that stands where it was put, s."""

    def __init__(self) -> None:
        self.now_s = 5.0

    def __call__(self) -> float:
        return self.now_s


class Fleet:
    """Four vehicles after five seconds, looked at; `counts` is what was refused on the wire."""

    def __init__(self, **record: object) -> None:
        self.clock, self.counts, self.sequences = HandMoved(), Counts(), SequenceTracker()
        self.engine = Engine(StraightLine(), settings())
        fly(self.engine, 0.0, 5.0)
        wanted = Settings.model_validate({"record": record})
        self.recording = FlightRecording(wanted.record, wanted.mavlink, self.engine)
        signed = SignedLinks(SigningConfig.model_validate({}), [])
        forwarder = Forwarder(
            ["udp:127.0.0.1:14551"],
            RouteTable(),
            signed,
            self.clock,
            own=(254, 191),
            bytes_per_s=1e5,
            is_aided=lambda _: False,
            forwarded=lambda _: None,
            foreign_gps_input=lambda _raw, _sysid: None,
        )
        refusals = Refusals([self.counts])
        self.snapshots = SnapshotCache(self.clock, self.engine, self.recording, self.sequences, refusals, forwarder)


def test_a_snapshot_is_shared_for_a_tenth_of_a_second():
    fleet = Fleet()
    first = fleet.snapshots.recent_snapshot()
    fleet.clock.now_s = 5.1
    assert fleet.snapshots.recent_snapshot() is first
    fleet.clock.now_s = 5.11
    assert fleet.snapshots.recent_snapshot().at_s == 5.11


def test_a_full_snapshot_has_what_a_recent_one_leaves_out_and_is_counted_once():
    fleet = Fleet()
    fleet.counts.add(Refusal.BAD_CRC, 3)
    fleet.sequences.add(("here", 2, 1), 7, 0, 5.0)
    fleet.sequences.add(("here", 77, 1), 7, 0, 5.0)
    recent, full = fleet.snapshots.recent_snapshot(), fleet.snapshots.snapshot()
    assert (recent.links, recent.outs, "bad_crc" in recent.refused) == ((), (), False)
    assert [(link.sysid, link.received) for link in full.links] == [(1, 0), (2, 1), (3, 0), (4, 0)]
    assert [out.name for out in full.outs] == ["udpout:127.0.0.1:14551"]
    assert (full.at_s, full.vehicles, full.refused["bad_crc"]) == (recent.at_s, recent.vehicles, 3)
    fleet.counts.add(Refusal.BAD_CRC)
    assert fleet.snapshots.snapshot() is full
    fleet.clock.now_s = 6.0
    assert fleet.snapshots.snapshot().refused["bad_crc"] == 4


@pytest.mark.parametrize(("later_s", "recorded"), [(0.44, True), (0.46, False)])
def test_a_recorded_snapshot_serves_until_the_next_is_due(tmp_path, later_s, recorded):
    fleet = Fleet(directory=str(tmp_path / "flights"))
    fleet.recording.record_outputs(fleet.engine.reviewed_at_s, [])
    recorded_snapshot = fleet.recording.newest_snapshot
    assert recorded_snapshot is not None
    fleet.clock.now_s = recorded_snapshot.at_s + later_s
    assert (fleet.snapshots.recent_snapshot() is recorded_snapshot) is recorded
