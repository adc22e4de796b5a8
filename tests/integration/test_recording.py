"""A flight recorded from four real ArduPlane autopilots, one of which loses its GPS, through the command line."""

from __future__ import annotations

import json

import pytest
from command_line import gcs_coloc
from recordings import recording

pytestmark = pytest.mark.integration


@pytest.fixture(scope="module")
def report() -> dict:
    files = [str(recording(f"arduplane/{name}")) for name in ("flight.tlog", "ranges.csv", "truth.csv")]
    done = gcs_coloc("replay", files[0], "--ranges", files[1], "--truth", files[2], "--json")
    assert (done.returncode, done.stderr) == (0, "")
    return json.loads(done.stdout)


def test_every_frame_is_read_and_nothing_is_refused_but_ranges_that_are_too_long(report):
    """Of 6104 ranges 188 are too long by 5 to 60 m, all but 11 of those are refused, and 5 others."""
    assert report["records"] == 107_516
    assert report["damage"] == {}
    assert report["refused"] == {"range_jumped": 177 + 5 + 1}
    assert set(report["wire"]) <= {"not_wanted", "unknown_message"}
    assert [v["sysid"] for v in report["vehicles"]] == [1, 2, 3, 4]


def test_the_loss_and_the_return_of_gps_are_seen_when_they_happen(report):
    changes = {v["sysid"]: [(c["after"], c["at_s"] - report["first_unix_s"]) for c in v["health"]] for v in report["vehicles"]}
    for healthy in (1, 2, 3):
        assert [state for state, _ in changes[healthy]] == ["healthy"]
    states, times_s = zip(*changes[4], strict=True)
    assert states == ("healthy", "suspect", "failed", "recovering", "healthy")
    assert times_s[1] == pytest.approx(150.6, abs=0.3)  # the receiver's first report without a fix
    assert times_s[2] == pytest.approx(times_s[1] + 1.0, abs=0.3)
    returned_s = 330.8
    assert times_s[3] == pytest.approx(returned_s + 3.0, abs=0.3)  # steady for `steady_after_s`
    assert times_s[4] == pytest.approx(returned_s + 10.0, abs=0.3)


def test_the_plane_without_gps_is_located_better_than_by_a_plain_filter(report):
    sent = {v["sysid"]: v["gps_input"] for v in report["vehicles"]}
    assert all(sent[sysid] == {"fix": 0, "no_fix": 0} for sysid in (1, 2, 3))
    # From the loss until its own receiver is healthy again, and three seconds more to hand it back.
    assert sent[4]["fix"] == pytest.approx(10 * (189.2 + 3.0), abs=5)
    score = report["vehicles"][3]["score"]
    assert score["share_known"] == 1.0
    # A gated constant-velocity EKF on the same data: 1.29 m and 2.45 m; the plane's own dead reckoning: up to 73 m.
    assert score["horizontal"]["rmse_m"] <= 1.0
    assert score["horizontal"]["p95_m"] <= 2.0
    assert score["beyond_three_bounds"] == 0.0
    assert score["covered_95"] >= 0.93


def test_nothing_is_said_of_how_an_aid_is_taken_that_was_never_sent(report):
    """Another program recorded it, and its GPS2 is fed by nobody."""
    assert report["vehicles"][3]["gps_input"]["fix"] > 0
    assert report["errors"] == []
