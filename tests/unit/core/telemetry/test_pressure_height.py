"""Height from air pressure: what the weather and the sensor do to it is learnt beside vehicles with GPS."""

from __future__ import annotations

from collections import defaultdict

import pytest

from gcs_coloc.core.telemetry.altitude_builder import Barometer, pressure_altitude_m


def pressure_hpa(alt_m: float, qnh_hpa: float) -> float:
    """The barometric formula of the standard atmosphere for another pressure at sea level."""
    return qnh_hpa * (1.0 - 2.25577e-5 * alt_m) ** 5.25588


def fly(
    heights: dict[int, Barometer], alts_m: dict[int, float], start_s: float, stop_s: float, qnh_hpa, trusted=(1, 2, 4)
) -> None:
    for tenth in range(round(start_s * 10), round(stop_s * 10)):
        t = tenth / 10
        for sysid, alt_m in alts_m.items():
            bias_hpa = 0.3 if sysid == 4 else 0.0
            heights[sysid].add(pressure_hpa(alt_m, qnh_hpa(t)) + bias_hpa, t)
            if sysid in trusted:
                heights[sysid].learn(alt_m, t, heights.values())


def test_the_standard_atmosphere():
    assert pressure_altitude_m(1013.25) == pytest.approx(0.0)
    assert pressure_altitude_m(898.746) == pytest.approx(1000.0, abs=0.5)
    assert pressure_altitude_m(264.363) == pytest.approx(10_000.0, abs=5.0)


def test_the_offset_of_sensor_and_weather_is_learnt_while_the_gps_is_trusted():
    heights = defaultdict(Barometer)
    fly(heights, {1: 500.0, 4: 600.0}, 0.0, 30.0, lambda t: 990.0)
    fly(heights, {1: 500.0, 4: 630.0}, 30.0, 40.0, lambda t: 990.0, trusted=(1,))
    height = heights[4].height(39.9, heights.values())
    assert height is not None
    assert height.alt_msl_m == pytest.approx(630.0, abs=0.5)
    assert 0.5 < height.sigma_m < 2.0  # 30 m of climb on a day that may be off the standard


def test_a_change_of_the_weather_is_seen_in_the_others():
    """Five minutes in which the pressure falls by 1 hPa: 8 m."""
    heights = defaultdict(Barometer)
    fly(heights, {1: 500.0, 2: 520.0, 4: 500.0}, 0.0, 30.0, lambda t: 990.0)
    fly(heights, {1: 500.0, 2: 520.0, 4: 500.0}, 30.0, 330.0, lambda t: 990.0 - (t - 30.0) / 300.0, trusted=(1, 2))
    height = heights[4].height(329.9, heights.values())
    assert height is not None
    assert height.alt_msl_m == pytest.approx(500.0, abs=0.5)


def test_a_vehicle_that_never_had_gps_is_as_high_as_the_others_sensors_say_and_states_so():
    heights = defaultdict(Barometer)
    fly(heights, {1: 500.0, 2: 500.0, 4: 560.0}, 0.0, 30.0, lambda t: 990.0, trusted=(1, 2))
    height = heights[4].height(29.9, heights.values())
    assert height is not None
    assert abs(height.alt_msl_m - 560.0) < height.sigma_m
    assert height.sigma_m > 8.0


def test_without_anybody_to_learn_from_or_without_a_barometer_there_is_no_height():
    heights = defaultdict(Barometer)
    fly(heights, {4: 560.0}, 0.0, 30.0, lambda t: 990.0, trusted=())
    assert heights[4].height(29.9, heights.values()) is None
    fly(heights, {4: 560.0}, 30.0, 60.0, lambda t: 990.0)
    assert heights[4].height(61.0, heights.values()) is not None
    assert heights[4].height(65.0, heights.values()) is None


def test_a_climb_of_the_others_on_a_warm_day_is_no_change_of_the_weather():
    """The air column is 7 % longer than the standard's: the offsets of those that climb by 200 m change by 13 m."""
    heights = defaultdict(Barometer)

    def fly_warm(alts_m: dict[int, float], start_s: float, stop_s: float, trusted: tuple[int, ...]) -> None:
        for tenth in range(round(start_s * 10), round(stop_s * 10)):
            for sysid, alt_m in alts_m.items():
                heights[sysid].add(pressure_hpa(400.0 + (alt_m - 400.0) / 1.07, 1013.25), tenth / 10)
                if sysid in trusted:
                    heights[sysid].learn(alt_m, tenth / 10, heights.values())

    fly_warm({1: 500.0, 2: 520.0, 3: 540.0, 4: 500.0}, 0.0, 30.0, (1, 2, 3, 4))
    fly_warm({1: 700.0, 2: 720.0, 3: 740.0, 4: 500.0}, 30.0, 100.0, (1, 2, 3))
    height = heights[4].height(99.9, heights.values())
    assert height is not None
    assert height.alt_msl_m == pytest.approx(500.0, abs=2.0)
    assert height.sigma_m < 4.0
