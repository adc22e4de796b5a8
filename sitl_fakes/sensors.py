"""What an aircraft measures: GPS fixes, air data, heading, altitude and ranges.

The noise of the measurements and the faults that distort them are here, too.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from sitl_fakes.faults import Fault, GpsFrozen, GpsJammed, GpsLost, GpsSpoofed, RangeBias, RangeDropout, RangeStuck
from sitl_fakes.geodesy import Vector
from sitl_fakes.receivers import GpsFix
from sitl_fakes.scenario import DeadReckoning, Gps, Ranging

_BARO_CORRELATION_S = 300.0  # chosen: temperature and weather change within minutes
_ROLL_NOISE_RAD = math.radians(0.5)
EPSILON_S = 1e-9  # chosen: far below a step, far above rounding


class Purpose(IntEnum):
    """What a random stream is for."""

    GPS = 1
    JAMMING = 2
    RANGES = 3
    PAIR_BIAS = 4
    AIR_SENSORS = 5
    WIND = 6
    DOWNLINK = 7
    UPLINK = 8
    CLOCK = 9
    PHASES = 10


def stream(seed: int, purpose: Purpose, *keys: int) -> np.random.Generator:
    """Return the generator for a purpose; `keys` are system ids."""
    return np.random.default_rng([seed, int(purpose), *keys])


class GaussMarkov:
    """First-order Gauss-Markov process in `axes` dimensions.

    Its sigma is stationary. A correlation time of 0 s makes it white.
    """

    def __init__(self, rng: np.random.Generator, sigma: float, correlation_time_s: float, axes: int) -> None:
        self._rng = rng
        self._sigma = sigma
        self._time = correlation_time_s
        self._value: list[float] = (sigma * rng.standard_normal(axes)).tolist()
        self._step_s = math.nan
        self._keep = self._fresh = 0.0

    @property
    def value(self) -> list[float]:
        """The value now, one number per axis."""
        return self._value

    def advance(self, by_s: float) -> list[float]:
        """Move on by a time step and return the new value."""
        if by_s != self._step_s:
            self._step_s, self._keep = by_s, math.exp(-by_s / self._time) if self._time > 0.0 else 0.0
            self._fresh = self._sigma * math.sqrt(1.0 - self._keep * self._keep)
        keep, fresh = self._keep, self._fresh
        # As Python's floats: numpy's, one by one, cost three times as much in all that is reckoned with them.
        noise: list[float] = self._rng.standard_normal(len(self._value)).tolist()
        self._value = [keep * x + fresh * g for x, g in zip(self._value, noise, strict=True)]
        return self._value


class _Jammer:
    """What a jammed receiver reports, after the model of ArduPilot's SITL (SIM_GPS1_JAM).

    First nothing; then satellites, fix, position (steps of up to 200 m), velocity and stated accuracies that change at random
    about once a second.
    """

    def __init__(self, sysid: int, seed: int) -> None:
        self._rng = stream(seed, Purpose.JAMMING, sysid)
        self._fix: GpsFix | None = None
        self._silent_until_s = 0.0

    def clear(self) -> None:
        """End of the jamming: the next one starts from a clean receiver."""
        self._fix = None

    def report(self, clean: GpsFix, at_s: float, interval_s: float) -> GpsFix:
        """Return the receiver's message in place of the clean one."""
        rng = self._rng
        if self._fix is None:
            self._fix = clean
            self._silent_until_s = at_s + rng.uniform(1.0, 5.0)
        fix = self._fix
        if rng.random() < 1.1 * interval_s:
            east, north, up = fix.position_enu_m
            de, dn = rng.uniform(-200.0, 200.0, 2)
            fix = replace(fix, position_enu_m=(float(east + de), float(north + dn), up))
        if rng.random() < 0.8 * interval_s:
            ve, vn, vu = (float(v) for v in rng.uniform(-400.0, 400.0, 3))
            fix = replace(fix, velocity_enu_mps=(ve, vn, vu))
        if rng.random() < 3.0 * interval_s:
            satellites = int(rng.integers(2, 17))
            locked = satellites >= 4 and rng.random() < 0.5
            fix = replace(fix, satellites=satellites, fix_type=clean.fix_type if locked else 1)
        if rng.random() < 3.0 * interval_s:
            h, v, s = (float(a) for a in rng.uniform(0.0, 300.0, 3))
            fix = replace(fix, h_acc_m=h, v_acc_m=v, speed_acc_mps=s)
        self._fix = fix
        return replace(fix, fix_type=1, satellites=0) if at_s < self._silent_until_s else fix


class GpsSensor:
    """An aircraft's own receiver, with noise and faults.

    The position noise is white or Gauss-Markov, the velocity noise white.
    """

    def __init__(self, settings: Gps, sysid: int, seed: int) -> None:
        self._settings = settings
        self.interval_s = 1.0 / settings.rate_hz
        self._rng = stream(seed, Purpose.GPS, sysid)
        self._error = GaussMarkov(self._rng, 1.0, settings.correlation_time_s, 3)
        self._jammer = _Jammer(sysid, seed)
        self._last: GpsFix | None = None

    def measure(self, position_m: Vector, velocity_mps: Vector, faults: Iterable[Fault], at_s: float) -> GpsFix:
        """Return the receiver's message now.

        It follows from the true position and velocity (east, north, up) and the faults in force.

        A receiver without fix repeats its last position and accuracies with fix type 1 and three satellites.
        """
        s = self._settings
        unit_e, unit_n, unit_u = self._error.advance(self.interval_s)
        noise = (s.sigma_velocity_mps * self._rng.standard_normal(3)).tolist()
        clean = GpsFix(
            fix_type=s.fix_type,
            satellites=s.satellites,
            position_enu_m=(
                position_m[0] + s.sigma_h_m * unit_e,
                position_m[1] + s.sigma_h_m * unit_n,
                position_m[2] + s.sigma_v_m * unit_u,
            ),
            velocity_enu_mps=(velocity_mps[0] + noise[0], velocity_mps[1] + noise[1], velocity_mps[2] + noise[2]),
            h_acc_m=s.sigma_h_m,
            v_acc_m=s.sigma_v_m,
            speed_acc_mps=s.sigma_velocity_mps,
            hdop=s.hdop,
            vdop=2.0,
        )
        present = list(faults)
        fix = clean
        for fault in present:
            if isinstance(fault, GpsSpoofed):
                fix = _walked_off(fix, fault, at_s)
        if any(isinstance(f, GpsJammed) for f in present):
            fix = self._jammer.report(fix, at_s, self.interval_s)
        else:
            self._jammer.clear()
        last = self._last
        if last is not None and any(isinstance(f, GpsFrozen) for f in present):
            fix = last
        if any(isinstance(f, GpsLost) for f in present):
            return replace(last if last is not None else fix, fix_type=1, satellites=3)
        self._last = fix
        return fix


def _walked_off(fix: GpsFix, fault: GpsSpoofed, at_s: float) -> GpsFix:
    """Return the fix moved as a spoofer moves it."""
    heading = math.radians(fault.direction_deg)
    by_m = fault.offset_m + fault.speed_mps * (at_s - fault.at_s)
    east, north, up = fix.position_enu_m
    ve, vn, vu = fix.velocity_enu_mps
    speed_mps = fault.speed_mps if fault.velocity_follows else 0.0
    return replace(
        fix,
        position_enu_m=(east + by_m * math.sin(heading), north + by_m * math.cos(heading), up),
        velocity_enu_mps=(ve + speed_mps * math.sin(heading), vn + speed_mps * math.cos(heading), vu),
    )


@dataclass(frozen=True, slots=True)
class AirData:
    """What the autopilot reads without GPS.

    Airspeed (m/s), roll and heading (rad), barometric altitude above mean sea level (m), rate of climb of its accelerometers
    (m/s).
    """

    airspeed_mps: float
    roll_rad: float
    heading_rad: float
    altitude_m: float
    climb_mps: float


class AirSensors:
    """Airspeed, attitude and barometer of one aircraft, with their errors.

    Errors stay (bias, scale), wander or are white.
    """

    def __init__(self, settings: DeadReckoning, sysid: int, seed: int) -> None:
        rng = stream(seed, Purpose.AIR_SENSORS, sysid)
        self._rng = rng
        self._settings = settings
        self._heading_bias_rad = math.radians(settings.heading_bias_deg) * float(rng.standard_normal())
        self._airspeed_scale = 1.0 + settings.airspeed_scale * float(rng.standard_normal())
        self._wander = GaussMarkov(rng, 1.0, settings.wander_time_s, 2)
        self._baro = GaussMarkov(rng, settings.baro_sigma_m, _BARO_CORRELATION_S, 1)

    @property
    def heading_error_rad(self) -> float:
        """Error of the autopilot's heading now, without its white noise, rad."""
        return self._heading_bias_rad + math.radians(self._settings.heading_wander_deg) * self._wander.value[0]

    def measure(
        self, airspeed_mps: float, roll_rad: float, heading_rad: float, altitude_m: float, climb_mps: float, step_s: float
    ) -> AirData:
        """Read all of them once, from the true values."""
        s = self._settings
        g1, g2, g3 = self._rng.standard_normal(3).tolist()
        wander = self._wander.advance(step_s)[1]
        return AirData(
            airspeed_mps=airspeed_mps * (self._airspeed_scale + s.airspeed_wander * wander) + s.airspeed_noise_mps * g1,
            roll_rad=roll_rad + _ROLL_NOISE_RAD * g2,
            heading_rad=heading_rad + self.heading_error_rad + math.radians(s.heading_noise_deg) * g3,
            altitude_m=altitude_m + self._baro.advance(step_s)[0],
            climb_mps=climb_mps,
        )


@dataclass(frozen=True, slots=True)
class RangeSample:
    """One measured range (m) to a peer.

    `stated_sigma_m` is the standard deviation that the device states (0 unknown), `sequence` the number of the range.
    """

    peer: int
    range_m: float
    stated_sigma_m: float
    sequence: int


class Ranger:
    """The ranging device of one aircraft.

    It measures to each of its peers `rate_hz` times a second, evenly spread over the period.
    """

    def __init__(self, settings: Ranging, sysid: int, peers: Sequence[int], seed: int) -> None:
        self._settings = settings
        self._rng = stream(seed, Purpose.RANGES, sysid)
        period = 1.0 / settings.rate_hz
        self._due_s = {peer: k * period / len(peers) for k, peer in enumerate(peers)}
        self._sequence = dict.fromkeys(peers, 0)
        self._last_m: dict[int, float] = {}
        self._bias_m = {
            peer: settings.bias_sigma_m * float(stream(seed, Purpose.PAIR_BIAS, *sorted((sysid, peer))).standard_normal())
            for peer in peers
        }

    def measure(self, at_s: float, own_m: Vector, others_m: Mapping[int, Vector], faults: Iterable[Fault]) -> list[RangeSample]:
        """Return what the device reports at a time.

        Positions are true, east, north, up in m. A peer without one is not there.
        """
        due = [peer for peer, due_s in self._due_s.items() if due_s <= at_s + EPSILON_S]
        if not due:
            return []
        present = list(faults)
        samples = []
        for peer in due:
            self._due_s[peer] += 1.0 / self._settings.rate_hz
            peer_m = others_m.get(peer)
            sample = None if peer_m is None else self._measure_one(peer, math.dist(own_m, peer_m), present)
            if sample is not None:
                samples.append(sample)
        return samples

    def _measure_one(self, peer: int, true_m: float, faults: Sequence[Fault]) -> RangeSample | None:
        s = self._settings
        number = self._sequence[peer]
        self._sequence[peer] = (number + 1) & 0xFFFF
        measured = true_m + self._bias_m[peer] + s.sigma_m * float(self._rng.standard_normal())
        chance_lost, chance_outlier, how_long = self._rng.random(3).tolist()
        if chance_outlier < s.outlier_share:
            measured += s.outlier_min_m + how_long * (s.outlier_max_m - s.outlier_min_m)
        if true_m > s.max_range_m or chance_lost < s.loss:
            return None
        for fault in faults:
            if not isinstance(fault, RangeDropout | RangeBias | RangeStuck) or fault.peer not in (None, peer):
                continue
            if isinstance(fault, RangeDropout):
                return None
            measured = measured + fault.bias_m if isinstance(fault, RangeBias) else self._last_m.get(peer, measured)
        measured = max(measured, 0.01)
        self._last_m[peer] = measured
        return RangeSample(peer, measured, s.sigma_m if s.stated_sigma_m is None else s.stated_sigma_m, number)
