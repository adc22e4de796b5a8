"""What a flight was worth: the autopilot's and the service's positions against the simulator's truth, and one table of it all."""

from __future__ import annotations

import bisect
import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from four_ship import FourShip
from pilot import Pilot, Place3D, offset_m
from protection import BoundedFix, bounded_fixes
from pymavlink.dialects.v20 import ardupilotmega as mavlink

_LONGEST_GAP_S = 0.4
"""Truth is interpolated over no more: 8 m of flight at 22 m/s, straight to within a decimetre in a turn of 45 degrees of bank."""

SETTLED_S = 15.0
"""From so long after the fault on an estimate counts as settled."""

_SERVICE = 254
_FROM_POSITION = 1e-7


@dataclass
class Figures:
    """The figures of one flight; lengths in m, times in s, None where the flight has no such thing."""

    flight: str
    ekf_median_m: float | None = None
    ekf_rmse_m: float | None = None
    ekf_largest_m: float | None = None
    ekf_first_15_s_m: float | None = None
    ekf_stated_ratio: float | None = None
    """Root mean square of the autopilot's error over the accuracy that it states, where it does."""
    our_rmse_m: float | None = None
    our_largest_m: float | None = None
    stated_ratio: float | None = None
    """Root mean square of error over stated standard deviation, which is that of the worst direction: 1 to 1.4 is honest."""
    bound_covers: float | None = None
    """The share of what was sent whose error is within its 95 % bound."""
    beyond_3_bounds: int | None = None
    most_of_hpl: float | None = None
    """The largest error over its horizontal protection level, from the fault on: above 1 the level was not kept."""
    altitude_beyond_2_sigmas: float | None = None
    """The share of what was sent whose altitude is off by more than twice the vertical accuracy that was stated with it."""
    altitude_sd_with_gps_m: float | None = None
    altitude_sd_aided_m: float | None = None
    named_after_s: float | None = None
    switched_after_s: float | None = None
    healthy_after_end_s: float | None = None
    """From the end of the fault until the denied vehicle was healthy for good."""
    suspects: list[str] = field(default_factory=list)
    longest_silence_s: float | None = None
    log_lines: int | None = None
    notes: list[str] = field(default_factory=list)

    def row(self) -> str:
        """One line of the table (Markdown)."""

        def cell(value: float | int | None) -> str:
            return "-" if value is None else f"{value:.2f}" if isinstance(value, float) else str(value)

        numbers = [
            self.ekf_median_m, self.ekf_rmse_m, self.ekf_largest_m, self.ekf_first_15_s_m, self.ekf_stated_ratio,
            self.our_rmse_m, self.our_largest_m, self.stated_ratio, self.bound_covers,
            self.beyond_3_bounds, self.most_of_hpl, self.altitude_beyond_2_sigmas, self.altitude_sd_with_gps_m,
            self.altitude_sd_aided_m, self.named_after_s, self.switched_after_s, self.healthy_after_end_s,
        ]  # fmt: skip
        rest = [", ".join(self.suspects) or "none", cell(self.longest_silence_s), cell(self.log_lines), "; ".join(self.notes)]
        return "| " + " | ".join([self.flight, *map(cell, numbers), *rest]) + " |"


HEADER = (
    "| flight | EKF median | rmse | most | first 15 s | EKF error/stated | ours rmse | most | error/stated | bound covers |"
    " beyond 3 bounds | error/HPL, most | alt beyond 2 sigmas | alt sd GPS | alt sd aided | named | switched | healthy again |"
    " sound suspects | no aid | log lines | notes |\n|" + "---|" * 22
)


class Truth:
    """A vehicle's true positions, to be had at any time that they cover."""

    def __init__(self, places: Sequence[Place3D]) -> None:
        self._places = sorted(places, key=lambda p: p.unix_s)
        self._times_s = [p.unix_s for p in self._places]

    def at(self, unix_s: float) -> Place3D | None:
        """Position at a time, None where the truth has a gap."""
        i = bisect.bisect_left(self._times_s, unix_s)
        if i == 0 or i == len(self._times_s):
            return None
        a, b = self._places[i - 1], self._places[i]
        if b.unix_s - a.unix_s > _LONGEST_GAP_S:
            return None
        share = (unix_s - a.unix_s) / max(b.unix_s - a.unix_s, 1e-9)
        lat, lon, alt = (
            x + share * (y - x)
            for x, y in ((a.lat_deg, b.lat_deg), (a.lon_deg, b.lon_deg), (a.alt_m, b.alt_m))
        )  # fmt: skip
        return Place3D(unix_s, lat, lon, alt)

    def nearest(self, unix_s: float) -> Place3D:
        """The position whose time is nearest."""
        i = bisect.bisect_left(self._times_s, unix_s)
        return min(self._places[max(i - 1, 0) : i + 1], key=lambda p: abs(p.unix_s - unix_s))

    def altitudes_m(self, begins_s: float, ends_s: float) -> list[float]:
        """True altitudes between two times."""
        return [p.alt_m for p in self._places if begins_s <= p.unix_s < ends_s]


@dataclass(frozen=True)
class Sent:
    """A fix as the service sent it: its time of sending, position, stated standard deviations (m), fix type."""

    place: Place3D
    accuracy_m: float
    vertical_accuracy_m: float
    fix_type: int


def errors_m(places: Sequence[Place3D], truth: Truth, begins_s: float, ends_s: float, age_s: float = 0.0) -> list[float]:
    """Horizontal errors of positions between two times; each is of `age_s` before its stamp."""
    within = [p for p in places if begins_s <= p.unix_s < ends_s]
    return [math.hypot(*offset_m(true, p)) for p in within if (true := truth.at(p.unix_s - age_s)) is not None]


def rms(values: Sequence[float]) -> float | None:
    """Root mean square, None of nothing."""
    return float(np.sqrt(np.mean(np.square(values)))) if values else None


def median(values: Sequence[float]) -> float | None:
    """Median, None of nothing."""
    return float(np.median(values)) if values else None


def altitude_beyond_2_sigmas(fixes: Sequence[Sent], truth: Truth, age_s: float) -> float | None:
    """Share of fixes whose altitude of `age_s` before is off by more than two of their vertical accuracies; None of none."""
    beyond = [
        abs(true.alt_m - f.place.alt_m) > 2.0 * f.vertical_accuracy_m
        for f in fixes
        if (true := truth.at(f.place.unix_s - age_s)) is not None
    ]
    return sum(beyond) / len(beyond) if beyond else None


def healthy_after_s(states: Sequence[tuple[float, int, str]], sysid: int, ends_s: float) -> float | None:
    """How long after a time a vehicle became healthy and stayed so; None where it did not, or was all the time.

    `states` are changes: UNIX time, system id, GPS state.
    """
    changes = [(at_s, state) for at_s, n, state in states if n == sysid and at_s >= ends_s]
    return changes[-1][0] - ends_s if changes and changes[-1][1] == "healthy" else None


def altitude_sd_m(truth: Truth, begins_s: float, ends_s: float) -> float | None:
    """Standard deviation of the true altitude, m: about its own mean, since the mission holds one altitude."""
    altitudes = truth.altitudes_m(begins_s, ends_s)
    return float(np.std(altitudes)) if len(altitudes) > 20 else None


def sent_fixes(recording: Path, target: int | None = None) -> list[Sent]:
    """GPS_INPUT and GLOBAL_POSITION_SENSOR that the service sent, from its recording, in order of time.

    GPS_INPUT names no target; one denied vehicle at a time is judged, standby streams stand aside by `target` (None: all).
    """
    out = []
    for unix_s, message in recorded(recording):
        if message.get_srcSystem() != _SERVICE:
            continue
        kind = message.get_type()
        if kind == "GPS_INPUT":
            place = Place3D(unix_s, message.lat * _FROM_POSITION, message.lon * _FROM_POSITION, message.alt)
            out.append(Sent(place, message.horiz_accuracy, message.vert_accuracy, message.fix_type))
        elif kind == "GLOBAL_POSITION_SENSOR" and target in (None, message.target_system):
            place = Place3D(unix_s, message.lat * _FROM_POSITION, message.lon * _FROM_POSITION, message.alt)
            out.append(Sent(place, message.eph, message.epv, 3))
    return out


def recorded(recording: Path) -> list[tuple[float, Any]]:
    """Messages of a tlog with their UNIX times."""
    data = recording.read_bytes()
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    out: list[tuple[float, Any]] = []
    at = 0
    while at + 8 + 12 <= len(data):
        stamp = struct.unpack_from(">Q", data, at)[0] * 1e-6
        size = 12 + data[at + 9] + (13 if data[at + 10] & 1 else 0) if data[at + 8] == 0xFD else 8 + data[at + 9]
        out += [(stamp, message) for message in parser.parse_buffer(data[at + 8 : at + 8 + size]) or []]
        at += 8 + size
    return out


def belongs(sent: Sent, truth: Truth, others: Sequence[Truth]) -> bool:
    """Whether a sent fix is about the vehicle of `truth`: the nearest of all (they fly hundreds of metres apart)."""

    def away_m(one: Truth) -> float:
        return math.hypot(*offset_m(one.nearest(sent.place.unix_s), sent.place))

    away = away_m(truth)
    return all(away <= away_m(other) for other in others)


def judge(ship: FourShip, denied: int, age_s: float, name: str) -> Figures:
    """The figures of one denied vehicle of a flight that is over. What was sent is of `age_s` before it was sent."""
    case, pilot = ship.case, ship.pilots[denied]
    truth = Truth(pilot.truth)
    begins_s, ends_s = ship.begins_s, ship.ends_s
    out = Figures(name)
    believed = errors_m(pilot.believed, truth, begins_s + SETTLED_S, ends_s)
    out.ekf_median_m, out.ekf_rmse_m, out.ekf_largest_m = median(believed), rms(believed), max(believed, default=None)
    out.ekf_first_15_s_m = max(errors_m(pilot.believed, truth, begins_s, begins_s + SETTLED_S), default=None)
    out.ekf_stated_ratio = rms(_over_stated(pilot, truth, begins_s + SETTLED_S, ends_s))
    out.altitude_sd_with_gps_m = altitude_sd_m(truth, begins_s - case.before_s, begins_s)
    out.altitude_sd_aided_m = altitude_sd_m(truth, begins_s + SETTLED_S, ends_s)
    sound = [n for n in ship.pilots if n not in case.denied]
    if ship.service is not None:
        others = [Truth(p.truth) for n, p in ship.pilots.items() if n != denied]
        fixes = [f for file in ship.service.recordings for f in sent_fixes(file, denied) if belongs(f, truth, others)]
        _judge_sent(out, fixes, truth, begins_s, ends_s + case.after_s, age_s, ship.killed_s)
        bounded = [each for file in ship.service.recordings for each in bounded_fixes(file, ship.service.configuration, denied)]
        _judge_bounds(out, [f for f in bounded if f.place.unix_s >= begins_s], truth, begins_s + SETTLED_S, age_s)
        since = [(at, n, state) for at, n, state in ship.service.states if at >= begins_s]
        out.named_after_s = next((at - begins_s for at, n, state in since if n == denied and state == "failed"), None)
        if case.end is not None:
            out.healthy_after_end_s = healthy_after_s(since, denied, ends_s)
        suspected_after_s = {
            n: at - begins_s for at, n, state in reversed(since) if n in sound and state in ("suspect", "failed")
        }
        out.suspects = [f"{n} after {at:.0f} s" for n, at in sorted(suspected_after_s.items())]
        out.log_lines = ship.log_lines
        out.switched_after_s = next(
            (float(m[1]) - begins_s for m in _switches(ship.service.recordings) if float(m[1]) >= begins_s), None
        )
    return out


def _over_stated(pilot: Pilot, truth: Truth, begins_s: float, ends_s: float) -> list[float]:
    stated = [(at_s, accuracy) for at_s, accuracy in pilot.stated_m if accuracy > 0.0]
    out = []
    for place in pilot.believed:
        if stated and begins_s <= place.unix_s < ends_s and (true := truth.at(place.unix_s)) is not None:
            i = bisect.bisect_left(stated, (place.unix_s, 0.0))
            out.append(math.hypot(*offset_m(true, place)) / stated[min(i, len(stated) - 1)][1])
    return out


def _judge_sent(
    out: Figures, fixes: Sequence[Sent], truth: Truth, begins_s: float, ends_s: float, age_s: float, killed_s: Sequence[float]
) -> None:
    good = [f for f in fixes if f.fix_type >= 3 and begins_s + SETTLED_S <= f.place.unix_s < ends_s]
    pairs = [
        (math.hypot(*offset_m(true, f.place)), f.accuracy_m)
        for f in good
        if (true := truth.at(f.place.unix_s - age_s)) is not None
    ]
    out.our_rmse_m, out.our_largest_m = rms([e for e, _ in pairs]), max((e for e, _ in pairs), default=None)
    out.stated_ratio = rms([e / s for e, s in pairs])
    out.altitude_beyond_2_sigmas = altitude_beyond_2_sigmas(good, truth, age_s)
    # A service that is killed was sending until then: what it had not written yet is lost from its recording, not from the air.
    sent_s = [*(f.place.unix_s for f in fixes if f.fix_type >= 3), *killed_s]
    times = sorted(t for t in sent_s if begins_s <= t < ends_s)
    out.longest_silence_s = max((b - a for a, b in pairwise(times)), default=None)


def _judge_bounds(out: Figures, fixes: Sequence[BoundedFix], truth: Truth, settled_s: float, age_s: float) -> None:
    """Errors against the bounds that they were stated with; coverage from `settled_s` on."""
    errors = [(math.hypot(*offset_m(true, f.place)), f) for f in fixes if (true := truth.at(f.place.unix_s - age_s)) is not None]
    if not errors:
        return
    settled = [error_m <= f.bound_95_m for error_m, f in errors if f.place.unix_s >= settled_s]
    out.bound_covers = sum(settled) / len(settled) if settled else None
    out.beyond_3_bounds = sum(error_m > 3.0 * f.bound_95_m for error_m, f in errors)
    out.most_of_hpl = max(error_m / f.hpl_m for error_m, f in errors)


def _switches(recordings: Sequence[Path]) -> list[tuple[str, float]]:
    """PARAM_SET of GPS_PRIMARY that the service sent: the name and the time."""
    return [
        (message.param_id, unix_s)
        for file in recordings
        for unix_s, message in recorded(file)
        if message.get_type() == "PARAM_SET" and message.get_srcSystem() == _SERVICE and message.param_id == "GPS_PRIMARY"
    ]


def at_most(**limits: tuple[float | None, float]) -> None:
    """Fail with every figure that is missing or beyond its limit."""
    missed = [f"{name} {found} > {limit}" for name, (found, limit) in limits.items() if found is None or not found <= limit]
    assert not missed, "; ".join(missed)


LEAST_COVERED = 0.93
"""Of the 95 % bound. Errors last for seconds, so that a flight of three minutes has some fifty independent ones."""


def at_least(**limits: tuple[float | None, float]) -> None:
    """Fail with every figure that is missing or below its limit."""
    missed = [f"{name} {found} < {limit}" for name, (found, limit) in limits.items() if found is None or not found >= limit]
    assert not missed, "; ".join(missed)
