from __future__ import annotations

from gcs_coloc.core.measurements import AltitudeMeasurement, RangeMeasurement
from gcs_coloc.estimators.fleet.ekf.records import IN_USE_S, Neighbour, Records, VehicleRecord


def test_copies_share_a_record_until_one_of_them_changes_it():
    first = Records()
    for vehicle in (1, 2, 3):
        first.writable(vehicle).last_range_s[9] = 0.0
    second = first.copy()
    assert all(second[vehicle] is first[vehicle] for vehicle in (1, 2, 3))
    first.writable(1).last_range_s[9] = 1.0
    second.writable(2).manoeuvre.update(5.0, 3.0, [0.1], [0.2], [0.3], [1.0])
    assert (first[1].last_range_s[9], second[1].last_range_s[9]) == (1.0, 0.0)
    assert (first[2].manoeuvre.c_n, second[2].manoeuvre.c_n) == (0.0, 0.2)
    assert second[3] is first[3]


def test_a_record_is_copied_once_and_then_changed_in_place():
    records = Records()
    before = records.writable(1)
    assert records.writable(1) is before
    other = records.copy()
    own = other.writable(1)
    assert own is not before
    assert other.writable(1) is own
    # The one that was copied from may not change what it shares either.
    assert records.writable(1) is not before


def test_what_is_remembered_ends_three_seconds_before_the_newest_and_at_64():
    record = VehicleRecord()
    for k in range(300):
        record.add_own(AltitudeMeasurement(1, 0.1 * k, 0.1 * k, float(k), 1.0))
        record.add_range(RangeMeasurement(1, 2, 0.01 * k, 0.01 * k, float(k), 1.0))
        assert len(record.own_measurements) <= 128
        assert len(record.range_measurements) <= 240
    assert [m.up_m for m in record.recent_own] == [float(k) for k in range(269, 300)]
    assert [m.range_m for m in record.recent_ranges] == [float(k) for k in range(180, 300)]


def test_a_neighbour_is_in_use_until_its_next_range_is_overdue():
    def in_use_s(intervals_s: list[float]) -> float:
        at_s, known = 0.0, Neighbour(0.0, (1.0, 0.0, 0.0), (1, 2, 0), 1.0)
        for step_s in intervals_s:
            at_s += step_s
            known = Neighbour(at_s, known.unit, known.pair, known.sigma_m, known.interval_until_s(at_s))
        return known.in_use_s

    assert in_use_s([]) == in_use_s([0.2] * 40) == IN_USE_S
    assert 2.9 < in_use_s([1.0] * 40) < 3.0
    # Two at a time, as of beacons that are ranged in turns.
    assert in_use_s([4.0, 0.2] * 20) > 4.0
    assert in_use_s([10.0] * 40) == 6.0
    # One gap among many ranges is no interval.
    assert in_use_s([*[0.2] * 40, 3.0]) < 2.5
