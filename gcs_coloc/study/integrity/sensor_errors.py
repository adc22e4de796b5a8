"""Error models of the trials: receivers, barometers, ranging devices and links, drawn for one flight.

Nothing here is shared with the estimators' noise models.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from math import cos, inf, pi, radians, sin

import numpy as np

from gcs_coloc.core.measurements import FloatArray, Vector3
from gcs_coloc.study.integrity.flight_classes import FlightClass, RangeNoise, Span
from gcs_coloc.study.integrity.motion import between_rows, gauss_markov

_SLOW_STEP_S = 1.0  # chosen: the slow errors change over 30 s and more
_HEIGHT_TIME_S = 200.0  # chosen: temperature and weather change within minutes
_VERTICAL_SHARE = 1.6
"""Vertical over horizontal error of a receiver; source: usual VDOP over HDOP."""
_COMMON_TIME_S = 300.0
"""Of ionosphere and orbits; source: residuals of single-frequency receivers change over 5 to 30 minutes."""
_UTC_BEHIND_S = (0.0, 0.3)
"""How far an autopilot's UTC is behind. Source: 0.19 s on ArduPlane 4.7 with a simulated receiver."""
_CLEAR_S, _BLOCKED_S = 30.0, 4.0  # chosen: past a building, or a hill, every half minute
_DETOUR_M = (3.0, 40.0)  # chosen: the way around a building
_FLICKER_LOST_S, _FLICKER_BACK_S, _FLICKER_M = 4.0, 2.0, 60.0  # chosen: a jammed receiver comes and goes
_HEARD_S = 25.0  # chosen: an antenna in the shadow of a banking wing, twice or thrice a minute
_REBOOT_S = (3.0, 12.0)  # chosen: autopilots boot within so long
_MOST_DRIFT = 20e-6
"""Of a crystal oscillator; source: data sheets of autopilots' crystals, 10 to 20 ppm."""

Intervals = list[tuple[float, float]]


def uniform_sign(rng: np.random.Generator, span: Span) -> float:
    """Draw a value within a span, of either sign."""
    return float(rng.uniform(*span) * rng.choice((-1.0, 1.0)))


def direction(rng: np.random.Generator) -> Vector3:
    """Draw a horizontal unit vector."""
    angle = rng.uniform(0.0, 2.0 * pi)
    return sin(angle), cos(angle), 0.0


def scaled(factor: float, vector: Vector3) -> Vector3:
    """Return a vector times a factor."""
    east, north, up = vector
    return factor * east, factor * north, factor * up


def is_within(intervals: Intervals, at_s: float) -> bool:
    """Whether a time is in one of the intervals."""
    return bool(intervals) and any(start <= at_s < end for start, end in intervals)


def draw_intervals(rng: np.random.Generator, mean_off_s: float, mean_on_s: float, until_s: float) -> Intervals:
    """Draw intervals of a mean length, exponential, with exponential pauses between them."""
    found: Intervals = []
    at_s = rng.exponential(mean_off_s)
    while at_s < until_s:
        end_s = at_s + rng.exponential(mean_on_s)
        found.append((at_s, end_s))
        at_s = end_s + rng.exponential(mean_off_s)
    return found


@dataclass(slots=True)
class Fault:
    """A false offset of one receiver from `at_s` on.

    The offset is `step_m` at once and grows by `ramp_mps`, in the direction `away`. The autopilot's filter follows it after
    `followed_after_s` and reports a glitch until then. `moves_doppler`: the receiver's own velocity is that of the false track.
    """

    at_s: float
    step_m: float
    ramp_mps: float
    away: Vector3
    followed_after_s: float = 0.0
    moves_doppler: bool = False

    def offset_m(self, at_s: float) -> Vector3:
        """Return the offset at a time, m."""
        passed_s = at_s - self.at_s
        return scaled(self.step_m + self.ramp_mps * passed_s, self.away) if passed_s >= 0.0 else (0.0, 0.0, 0.0)

    def doppler_mps(self, at_s: float) -> Vector3:
        """Return the error of the receiver's own velocity at a time, m/s."""
        return scaled(self.ramp_mps if self.moves_doppler and at_s >= self.at_s else 0.0, self.away)


class PitotFault(Enum):
    """What the pitot tube of a vehicle comes to read."""

    STUCK = "what it read last, as of one that is iced up"
    CONSTANT = "a constant, as of a broken sensor"
    FACTOR = "a multiple, as of one that leaks or is half blocked"


_PITOT_CONSTANT_MPS = (6.0, 100.0)  # chosen: from below stall speed up; a lower one is none
_JUMPS_BACK_S = (5.0, 30.0)  # chosen: shorter and longer than fault tests remember
_PITOT_FACTOR = (0.5, 2.0)  # chosen: a quarter to four times the pressure


@dataclass(slots=True)
class PitotFailure:
    """A pitot tube that reads wrong from `at_s` on; `constant_mps` is what it read last, once it is stuck."""

    at_s: float
    fault: PitotFault
    constant_mps: float | None
    factor: float

    @classmethod
    def draw(cls, rng: np.random.Generator, at_s: float) -> PitotFailure:
        """Draw one."""
        fault = list(PitotFault)[int(rng.integers(len(PitotFault)))]
        constant_mps = float(rng.uniform(*_PITOT_CONSTANT_MPS)) if fault is PitotFault.CONSTANT else None
        factor = float(np.exp(rng.uniform(*np.log(_PITOT_FACTOR)))) if fault is PitotFault.FACTOR else 1.0
        return cls(at_s, fault, constant_mps, factor)

    def reads_mps(self, sound_mps: float, at_s: float) -> float:
        """Return what it reads where a sound one reads `sound_mps`; of times that never decrease."""
        if at_s < self.at_s:
            return sound_mps
        if self.fault is PitotFault.FACTOR:
            return self.factor * sound_mps
        if self.constant_mps is None:
            self.constant_mps = sound_mps
        return self.constant_mps


@dataclass(frozen=True, slots=True)
class BarometerJump:
    """A barometer that reads wrong from one time to another."""

    from_s: float
    until_s: float
    jump_m: float

    @classmethod
    def draw(cls, rng: np.random.Generator, at_s: float, jump_m: Span) -> BarometerJump:
        """Draw one that begins at a time."""
        jumps_back = rng.random() < 0.5
        return cls(at_s, at_s + rng.uniform(*_JUMPS_BACK_S) if jumps_back else inf, uniform_sign(rng, jump_m))

    def offset_m(self, at_s: float) -> float:
        """Return how much too high it reads at a time, m."""
        return self.jump_m if self.from_s <= at_s < self.until_s else 0.0


class ReceiverErrors:
    """Errors of one vehicle's receiver, barometer, compass, pitot tube and UTC.

    Positions are east, north, up in m. `heading_rad` is the error of the compass, `pitot` the factor of the pitot tube,
    `utc_behind_s` the delay of UTC.
    """

    def __init__(self, rng: np.random.Generator, drawn: FlightClass, common_m: FloatArray, duration_s: float) -> None:
        sigma_m, white_m = rng.uniform(*drawn.gnss_sigma_m), rng.uniform(*drawn.gnss_white_m)
        steps = round(duration_s / _SLOW_STEP_S) + 3
        own = gauss_markov(rng, steps, _SLOW_STEP_S, sigma_m, rng.uniform(*drawn.gnss_time_s))
        self._slow_m: list[list[float]] = ((own + common_m) * (1.0, 1.0, _VERTICAL_SHARE)).tolist()
        height_m = gauss_markov(rng, steps, _SLOW_STEP_S, rng.uniform(*drawn.height_drift_m), _HEIGHT_TIME_S, 1)[:, 0]
        self._height_m: list[float] = (height_m + uniform_sign(rng, drawn.height_bias_m)).tolist()
        self._rng = rng
        self.white_m = white_m
        self.stated_m = float(np.hypot(sigma_m, white_m) * rng.uniform(*drawn.gnss_stated))
        self.stated_vertical_m = _VERTICAL_SHARE * self.stated_m
        self.heading_rad = radians(uniform_sign(rng, drawn.heading_error_deg))
        self.pitot = rng.uniform(0.97, 1.03)
        self.utc_behind_s = rng.uniform(*_UTC_BEHIND_S)

    @staticmethod
    def common_m(rng: np.random.Generator, drawn: FlightClass, duration_s: float) -> FloatArray:
        """Draw the slow error (N, 3) that all receivers of a flight share."""
        steps = round(duration_s / _SLOW_STEP_S) + 3
        return gauss_markov(rng, steps, _SLOW_STEP_S, rng.uniform(*drawn.gnss_common_m), _COMMON_TIME_S)

    def slow_m(self, at_s: float) -> Vector3:
        """Return the slow error of the position."""
        step = min(int(at_s / _SLOW_STEP_S), len(self._slow_m) - 2)
        return between_rows(self._slow_m, step, at_s / _SLOW_STEP_S - step)

    def height_m(self, at_s: float) -> float:
        """Return the error of the barometric height."""
        step = min(int(at_s / _SLOW_STEP_S), len(self._height_m) - 2)
        share = at_s / _SLOW_STEP_S - step
        return self._height_m[step] + share * (self._height_m[step + 1] - self._height_m[step])

    def velocity_mps(self, at_s: float) -> Vector3:
        """Return the error of the velocity: what the slow error changes by, and white noise."""
        (e, n, u), (later_e, later_n, later_u) = self.slow_m(at_s), self.slow_m(at_s + _SLOW_STEP_S)
        white_e, white_n, white_u = self._rng.standard_normal(3).tolist()
        return (
            (later_e - e) / _SLOW_STEP_S + 0.1 * white_e,
            (later_n - n) / _SLOW_STEP_S + 0.1 * white_n,
            (later_u - u) / _SLOW_STEP_S + 0.1 * white_u,
        )


class PairErrors:
    """Errors of the ranges of one pair.

    `device_m` is the bias from both devices, `scale` the scale error from both.
    """

    def __init__(self, rng: np.random.Generator, drawn: FlightClass, sigma_m: float, device_m: float, scale: float, end_s: float):
        self._rng, self._noise, self.sigma_m = rng, drawn.range_noise, sigma_m
        self._device_m, self._scale, self._loss = device_m, scale, rng.uniform(*drawn.range_loss)
        gap_s = rng.uniform(*drawn.range_gap_s)
        self._gaps = draw_intervals(rng, gap_s, gap_s, end_s) if gap_s > 0.0 else []
        is_blocked = drawn.range_noise is RangeNoise.BLOCKED
        self._blocked = draw_intervals(rng, _CLEAR_S, _BLOCKED_S, end_s) if is_blocked else []
        self._detours_m = {start_s: rng.uniform(*_DETOUR_M) for start_s, _ in self._blocked}

    def measure(self, true_m: float, at_s: float) -> float | None:
        """Return the measured range, m; None where it is lost."""
        if self._rng.random() < self._loss or is_within(self._gaps, at_s):
            return None
        return max(true_m * (1.0 + self._scale) + self._device_m + self._noise_m(at_s), 0.0)

    def _noise_m(self, at_s: float) -> float:
        rng, sigma_m = self._rng, self.sigma_m
        match self._noise:
            case RangeNoise.STUDENT:
                return float(sigma_m * rng.standard_t(3) / np.sqrt(3.0))
            case RangeNoise.SKEWED:
                return float(0.8 * sigma_m * rng.standard_normal() + rng.exponential(sigma_m))
            case RangeNoise.BLOCKED:
                detour_m = next((self._detours_m[start] for start, end in self._blocked if start <= at_s < end), 0.0)
                return float(sigma_m * rng.standard_normal() + detour_m)
        return float(sigma_m * rng.standard_normal())


class LinkErrors:
    """Delays of one vehicle's link, both ways, and its boot clock.

    Messages from the vehicle keep their order.
    """

    def __init__(self, rng: np.random.Generator, drawn: FlightClass, least_s: float, end_s: float) -> None:
        self._rng, self._least_s, self._jitter_s = rng, least_s, rng.uniform(*drawn.jitter_s)
        # Up and down are a little different: no clock exchange can see that.
        self._down_s = least_s * rng.uniform(0.8, 1.2)
        self._boot_s, self._drift = rng.uniform(20.0, 3000.0), rng.uniform(-_MOST_DRIFT, _MOST_DRIFT)
        self._rebooted: Intervals = []
        has_blackouts = drawn.blackout_s[1] > 0.0
        self._blackouts = draw_intervals(rng, _HEARD_S, rng.uniform(*drawn.blackout_s), end_s) if has_blackouts else []
        self._last_s = -inf

    def add_reboot(self, start_s: float, end_s: float) -> None:
        """From `start_s` on the vehicle is silent; its clock begins at zero a second before `end_s`."""
        self._rebooted.append((start_s, end_s))

    def is_off(self, at_s: float) -> bool:
        """Whether the vehicle reboots at a time."""
        return is_within(self._rebooted, at_s)

    def is_silent(self, at_s: float) -> bool:
        """Whether nothing comes from the vehicle, or to it, at a time."""
        return self.is_off(at_s) or is_within(self._blackouts, at_s)

    def arrival_s(self, sent_s: float) -> float:
        """Return when what is sent at a time arrives at the service."""
        self._last_s = max(self._last_s, sent_s + self._least_s + self._rng.exponential(self._jitter_s))
        return self._last_s

    def delivery_s(self, sent_s: float) -> float:
        """Return when what the service sends at a time arrives at the vehicle."""
        return sent_s + self._down_s + float(self._rng.exponential(self._jitter_s))

    def boot_s(self, at_s: float) -> float:
        """Return the vehicle's own clock at a time."""
        if self._rebooted:
            began_s = max((end - 1.0 for start, end in self._rebooted if at_s >= end), default=None)
            if began_s is not None:
                return (at_s - began_s) * (1.0 + self._drift)
        return (at_s + self._boot_s) * (1.0 + self._drift)


def draw_flicker(rng: np.random.Generator, lost_at_s: float, end_s: float) -> list[tuple[float, float, Vector3]]:
    """Draw when a jammed receiver has a fix again after the loss, and its offset (m) each time."""
    times = draw_intervals(rng, _FLICKER_LOST_S, _FLICKER_BACK_S, end_s - lost_at_s)
    return [(lost_at_s + a, lost_at_s + b, scaled(rng.uniform(0.0, _FLICKER_M), direction(rng))) for a, b in times]


def draw_reboot(rng: np.random.Generator, earliest_s: float, end_s: float) -> tuple[float, float]:
    """Draw the silence of a reboot."""
    start_s = rng.uniform(earliest_s, max(earliest_s, 0.8 * end_s))
    return start_s, start_s + rng.uniform(*_REBOOT_S)
