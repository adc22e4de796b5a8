"""What a second of ranges says beyond the distance of the places, and how sure it is of that."""

import numpy as np
import pytest

from gcs_coloc.core.integrity.range_residuals import RangeResidualBuffer, RangeResidualSettings, ReportedTrack
from gcs_coloc.core.measurements import RangeMeasurement

APART_M = 1000.0


def rows_of(ranges_m, every_s=0.2):
    rows = RangeResidualBuffer()
    for k, range_m in enumerate(ranges_m):
        t = k * every_s
        for vehicle, east_m in ((1, 20.0 * t), (2, 20.0 * t + APART_M)):
            place = ReportedTrack(t, (east_m, 0.0, 100.0), (20.0, 0.0, 0.0), 1.5, 2.0, free=False)
            rows.place(vehicle, place)
        rows.range(RangeMeasurement(1, 2, t, t, range_m, 1.0))
    return rows.scene((len(ranges_m) - 1) * every_s + RangeResidualSettings().wait_s).rows


def test_a_single_late_range_does_not_move_a_row():
    (row,) = rows_of([APART_M + 2.0, APART_M + 2.1, APART_M + 80.0, APART_M + 1.9, APART_M + 2.0])
    assert row.residual_m == pytest.approx(2.0, abs=0.11)
    # 1 m, five ranges, a median: 0.56 m, and the tenth that no averaging removes.
    assert row.sigma_m == pytest.approx(np.sqrt(1.57 / 5 + 0.1), rel=1e-6)


def test_where_most_ranges_are_late_the_row_is_as_uncertain_as_it_is_wrong():
    for late_m in (10.0, 30.0, 100.0):
        (row,) = rows_of([APART_M, APART_M + late_m, APART_M + 0.1, APART_M + late_m, APART_M + late_m])
        assert row.residual_m == pytest.approx(late_m)
        assert row.residual_m < 2.6 * row.sigma_m


def test_few_ranges_make_a_row_of_a_longer_time_and_too_few_none():
    # Every 0.5 s: two in the last second, three in the last 1.4 s.
    assert len(rows_of([APART_M] * 6, every_s=0.5)) == 1
    assert rows_of([APART_M] * 6, every_s=0.9) == ()


def test_between_two_reports_a_place_is_the_nearer_one_carried_on_by_its_velocity():
    """One flies at 20 m/s by its first report and at 10 m/s by its second, a second later; the other one stands."""
    rows = RangeResidualBuffer()
    for t, east_m, ve_mps in ((0.0, 0.0, 20.0), (1.0, 20.0, 10.0)):
        rows.place(1, ReportedTrack(t, (east_m, 0.0, 100.0), (ve_mps, 0.0, 0.0), 1.5, 2.0, free=False))
        rows.place(2, ReportedTrack(t, (-APART_M, 0.0, 100.0), (0.0, 0.0, 0.0), 1.5, 2.0, free=False))
    for t, east_m in ((0.3, 6.0), (0.5, 10.0), (0.7, 17.0), (1.2, 22.0), (1.59, 25.9)):
        rows.range(RangeMeasurement(1, 2, t, t, APART_M + east_m + 2.0, 1.0))
    rows.range(RangeMeasurement(1, 2, 1.61, 1.61, APART_M, 1.0))  # too long after the last report for a place
    scene = rows.scene(1.85)
    assert scene.places[1].position_enu_m == pytest.approx((21.5, 0.0, 100.0))
    (row,) = scene.rows
    assert row.residual_m == pytest.approx(2.0, abs=1e-9)
    # All five agree to the last bit, so the noise is what is stated.
    assert row.sigma_m == pytest.approx(np.sqrt(1.57 / 5 + 0.1), rel=1e-6)
