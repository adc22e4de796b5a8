"""Receivers whose fixes move other than their own velocity, and the honest ones that say nothing against themselves."""

from __future__ import annotations

import numpy as np
import pytest
from engine_flights import LAT, LON

from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.gps_health.position_checks import DopplerCheck
from gcs_coloc.core.messages.inbound import GpsReceiver
from gcs_coloc.mavlink.inbound import gps_raw_int

FRAME = LocalFrame(LAT, LON, 500.0)
WALKS_AT_S, SPEED_MPS, TURN_RADPS = 20.0, 20.0, 0.3
WALK_MPS = 2.0


def drifted(
    seed: int,
    *,
    walk_mps: float = WALK_MPS,
    velocity_follows: bool = False,
    sigma_m: float = 1.0,
    correlation_s: float = 30.0,
    rate_hz: float = 5.0,
    boot_time: bool = True,
    stated_mps: float | None = 0.2,
    velocity: bool = True,
) -> list[float]:
    """When the check said that the receiver of a circling vehicle drifts, in 60 s of which the last 40 are walked off."""
    rng, check, out = np.random.default_rng(seed), DopplerCheck(), []
    error_m = rng.normal(0.0, sigma_m, 2)
    kept = np.exp(-1.0 / (rate_hz * correlation_s)) if correlation_s else 0.0
    for step in range(round(60.0 * rate_hz)):
        t = step / rate_hz
        error_m = kept * error_m + np.sqrt(1.0 - kept**2) * rng.normal(0.0, sigma_m, 2)
        angle, radius_m = TURN_RADPS * t, SPEED_MPS / TURN_RADPS
        walking = walk_mps if t >= WALKS_AT_S else 0.0
        east_m = radius_m * np.sin(angle) + error_m[0] + walking * (t - WALKS_AT_S)
        lat, lon, alt = FRAME.geodetic_from_enu(east_m, -radius_m * np.cos(angle) + error_m[1], 0.0)
        vn, ve = rng.normal((SPEED_MPS * np.sin(angle), SPEED_MPS * np.cos(angle)), 0.1)
        ne = (vn, ve + walking * velocity_follows) if velocity else (0.0, 0.0)
        fixed_s = t if boot_time else None
        check.add(GpsReceiver(1, t, 0, 3, lat, lon, alt, 10, 1.0, sigma_m, 1.5, stated_mps, fixed_s, None, ne))
        if check.drifts(t):
            out.append(t)
    return out


@pytest.mark.parametrize(("sigma_m", "rate_hz"), [(0.3, 5.0), (1.0, 5.0), (1.5, 10.0), (0.5, 1.0)])
def test_a_position_that_is_walked_off_alone_speaks_against_itself_within_a_window(sigma_m, rate_hz):
    for seed in range(10):
        at_s = drifted(seed, sigma_m=sigma_m, rate_hz=rate_hz)
        assert WALKS_AT_S < at_s[0] < WALKS_AT_S + 5.0
        assert at_s[-1] >= 59.0


@pytest.mark.parametrize(
    "how",
    [{"walk_mps": 0.0}, {"walk_mps": 0.0, "correlation_s": 0.0}, {"walk_mps": 0.0, "rate_hz": 1.0}, {"velocity_follows": True}],
    ids=["wandering error", "white error", "1 Hz", "a spoofer that moves both"],
)
def test_one_that_moves_as_its_velocity_says_does_not(how):
    assert [drifted(seed, **how) for seed in range(20)] == [[]] * 20


def test_one_that_never_states_its_velocity_or_no_time_shows_nothing():
    assert drifted(1, velocity=False) == []
    assert drifted(1, boot_time=False) == []


@pytest.mark.parametrize(("speed", "course", "expected"), [(2000, 9000, (0.0, 20.0)), (65535, 0, None), (2000, 65535, None)])
def test_the_velocity_is_read_off_speed_and_course(speed, course, expected):
    read = gps_raw_int(1, 0.0, (1_000_000, 475_000_000, 90_000_000, 0, 100, 100, speed, course, 3, 10, 0, 0, 0, 0, 0, 0))
    assert read.velocity_ne_mps == (pytest.approx(expected) if expected else None)
