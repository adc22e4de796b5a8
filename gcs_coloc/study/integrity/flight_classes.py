"""The flight classes of the integrity trials: what is drawn for each flight of a class."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from math import inf

Span = tuple[float, float]
"""Bounds between which a value is drawn uniformly for each flight."""


class Group(StrEnum):
    """What a class of flights shows; the goals differ by it."""

    NOMINAL = "nominal"
    """Four or more peers, 1 m ranges at 5 Hz, sensors as stated."""
    BENIGN = "benign"
    """Harder geometry, motion or links; no sensor is worse than it states."""
    IMPERFECT = "imperfect"
    """Sensors, devices or links are worse than they state; nobody is spoofed."""
    FAULT = "fault"
    """Receivers or ranging devices are faulty from some time on."""


class Layout(StrEnum):
    """Where the peers are, seen from the denied vehicle."""

    AROUND = "around"
    ASIDE = "aside"
    LINE = "line"
    CONVOY = "convoy"


class Motion(StrEnum):
    """How a vehicle moves."""

    PLANE = "plane"
    COPTER = "copter"
    AGILE = "agile"
    HOVER = "hover"


class RangeNoise(StrEnum):
    """The distribution of a range's error; all have the stated standard deviation but the last two."""

    GAUSS = "gauss"
    STUDENT = "student"
    """Student's t with three degrees of freedom: one in 150 beyond four sigmas."""
    SKEWED = "skewed"
    """A Gaussian and an exponential part that is never negative, as of a leading edge that is found late."""
    BLOCKED = "blocked"
    """A Gaussian, and for seconds at a time a detour of 3 to 40 m, as behind a building."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Spoofing:
    """Spoofed receivers: how many peers, or the vehicle's own one instead of the loss of its GPS.

    The false position is `step_m` away at once and moves off at `ramp_mps`; `is_alike`: all have one common false offset.
    """

    receivers: int = 1
    own: bool = False
    step_m: Span = (0.0, 0.0)
    ramp_mps: Span = (0.0, 0.0)
    is_alike: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightClass:
    """One class of flights: what is drawn for each of them.

    Sigmas are per axis. A value of type `Span` is drawn for each flight, or for each vehicle where it belongs to a vehicle.
    """

    name: str
    group: Group
    text: str
    # Geometry and motion
    peers: tuple[int, int] = (4, 6)
    denied: int = 1
    layout: Layout = Layout.AROUND
    extent_m: Span = (300.0, 1200.0)
    """Distance of the peers' centres from the denied vehicle's."""
    motions: tuple[Motion, ...] = (Motion.PLANE,)
    bank_deg: Span = (20.0, 45.0)
    """Steepest bank of a plane."""
    acceleration_mps2: Span = (1.0, 3.0)
    """Largest acceleration of a copter."""
    wind_mps: Span = (0.0, 8.0)
    gust_mps: Span = (0.2, 1.0)
    has_air_data: bool = True
    """Whether attitude, and airspeed of planes, is sent."""
    heading_error_deg: Span = (0.0, 3.0)
    from_origin_m: float = 0.0
    """Distance of the denied vehicle and its peers from the vehicle that sets the fleet's origin."""
    # Positions
    gnss_sigma_m: Span = (0.5, 1.5)
    """Slow error of each receiver, a Gauss-Markov process of `gnss_time_s`."""
    gnss_time_s: Span = (30.0, 300.0)
    gnss_white_m: Span = (0.1, 0.3)
    gnss_common_m: Span = (0.0, 0.3)
    """Slow error that all receivers share."""
    gnss_stated: Span = (1.0, 1.5)
    """Stated accuracy over the true standard deviation."""
    filters_positions: bool = True
    """Whether an autopilot filters its position.

    Else the white noise of its receiver is in it.
    """
    position_hz: float = 5.0
    """How often an autopilot reports its position."""
    telemetry_s: Span = (0.0, 0.0)
    """Period of all telemetry, one for the fleet, where its streams are slower than the service asks for."""
    height_drift_m: Span = (0.3, 1.0)
    """Slow error of each barometer over 200 s."""
    height_bias_m: Span = (0.0, 0.5)
    # Ranges
    range_sigma_m: Span = (1.0, 1.0)
    range_hz: Span = (5.0, 5.0)
    max_range_m: float = inf
    """Beyond it there is no range."""
    range_noise: RangeNoise = RangeNoise.GAUSS
    range_bias_m: Span = (0.0, 0.0)
    """Lasting error of each device, of either sign."""
    range_scale: Span = (0.0, 0.0)
    """Lasting scale error of each device, of either sign."""
    range_loss: Span = (0.0, 0.05)
    """Share of the ranges that is lost, one by one."""
    range_gap_s: Span = (0.0, 0.0)
    """Mean length of gaps in which one pair's ranges are lost; as long on average between two gaps."""
    is_mutual: bool = True
    """Whether peers range each other as well."""
    companion_wait_s: Span = (0.0, 0.0)
    """How long each range waits in a companion computer, whose clock it is stamped by; 0: by the autopilot's, at once."""
    companion_set_back_s: Span = (0.0, 0.0)
    """From some time on the clock of the denied vehicle's companion computer, which stamps its ranges, is set back by this."""
    pair_detour_m: Span = (0.0, 0.0)
    """By how much all ranges of one pair of the denied vehicle are too long."""
    silence_s: Span = (0.0, 0.0)
    """Length of two silences of all ranges."""
    # Links
    delay_s: Span = (0.02, 0.08)
    """Least one-way delay; drawn for each vehicle, or once for all where `is_delay_alike`."""
    is_delay_alike: bool = False
    jitter_s: Span = (0.005, 0.05)
    """Mean wait beyond the least delay, exponential."""
    answers_timesync: bool = True
    has_utc: bool = True
    """Whether vehicles send the UTC of their receivers (SYSTEM_TIME), 0 to 0.3 s behind."""
    blackout_s: Span = (0.0, 0.0)
    """Mean length of a vehicle's times without radio, both ways; its ranging device goes on."""
    reboots: bool = False
    """A peer and the denied vehicle are silent for 3 to 12 s, then go on with a clock that starts at zero."""
    # Beginning and faults
    lost_at_s: Span = (25.0, 45.0)
    """When the denied vehicle loses its fix."""
    flickers: bool = False
    """Whether the lost fix comes back for seconds at a time, up to 60 m off."""
    backlog_s: float = 0.0
    """Datagrams of so long before the service's start wait for it and are received at once."""
    spoofing: Spoofing | None = None
    device_step_m: Span = (0.0, 0.0)
    """From some time on all ranges of one device are longer or shorter by this; `device_ramp_mps`: ever more."""
    device_ramp_mps: Span = (0.0, 0.0)
    pitot_fails: bool = False
    """Whether the denied vehicle's pitot tube reads wrong from some time on."""
    attitude_freezes: bool = False
    """Whether the denied vehicle repeats its last attitude while all ranges are silent."""
    height_jump_m: Span = (0.0, 0.0)
    """By how much the denied vehicle's barometer jumps, up or down; half of them jump back after 5 to 30 s."""


_PLANES = FlightClass(name="planes", group=Group.NOMINAL, text="planes among four to six others that turn at random")
_COPTERS = replace(
    _PLANES,
    name="copters",
    text="copters from waypoint to waypoint",
    motions=(Motion.COPTER, Motion.HOVER),
    extent_m=(80.0, 400.0),
)
_STEP = Spoofing(step_m=(30.0, 300.0))
_AIRPORT = Spoofing(step_m=(20_000.0, 300_000.0))  # chosen: as far as spoofers state the nearest airports
_RAMP = Spoofing(ramp_mps=(0.2, 5.0))


def _benign(name: str, text: str, of: FlightClass = _PLANES, **changes: object) -> FlightClass:
    return replace(of, name=name, group=Group.BENIGN, text=text, **changes)  # type: ignore[arg-type]


def _imperfect(name: str, text: str, of: FlightClass = _PLANES, **changes: object) -> FlightClass:
    return replace(of, name=name, group=Group.IMPERFECT, text=text, **changes)  # type: ignore[arg-type]


def _fault(name: str, text: str, **changes: object) -> FlightClass:
    return replace(_PLANES, name=name, group=Group.FAULT, text=text, **changes)  # type: ignore[arg-type]


_ALL = (
    _PLANES,
    replace(_PLANES, name="steep-turns", text="planes that bank by up to 60 degrees", bank_deg=(45.0, 60.0)),
    _COPTERS,
    replace(_COPTERS, name="mixed", text="planes and copters", motions=(Motion.PLANE, Motion.COPTER), extent_m=(200.0, 800.0)),
    replace(_PLANES, name="two-denied", text="two denied vehicles that range each other", denied=2),
    _benign("agile-copters", "copters that accelerate by 5 to 8 m/s² every few seconds", _COPTERS,
            motions=(Motion.AGILE, Motion.COPTER), acceleration_mps2=(5.0, 8.0)),
    _benign("three-peers", "three peers", peers=(3, 3)),
    _benign("two-peers", "two peers, with air data", peers=(2, 2)),
    _benign("two-peers-no-air-data", "two peers, no attitude, no airspeed", peers=(2, 2), has_air_data=False),
    _benign("one-peer", "one peer, with air data", peers=(1, 1)),
    _benign("two-denied-copters", "two denied copters that range each other and two or three peers, with blackouts", _COPTERS,
            denied=2, peers=(2, 3), blackout_s=(3.0, 8.0)),
    _benign("no-air-data", "planes without attitude and airspeed", has_air_data=False),
    _benign("peers-aside", "all peers to one side, 1 to 3 km away", layout=Layout.ASIDE, extent_m=(1000.0, 3000.0)),
    _benign("peers-in-line", "hovering peers in one line that the denied copter crosses", _COPTERS,
            layout=Layout.LINE, extent_m=(150.0, 500.0)),
    _benign("convoy", "all in one line astern, on one course", layout=Layout.CONVOY, extent_m=(100.0, 400.0)),
    _benign("convoy-no-air-data", "the same without attitude and airspeed", layout=Layout.CONVOY, extent_m=(100.0, 400.0),
            has_air_data=False),
    _benign("slow-ranges", "ranges every one to two seconds", range_hz=(0.5, 1.0)),
    _benign("slow-telemetry", "all telemetry and ranges every one to two seconds", telemetry_s=(1.0, 2.0), range_hz=(0.5, 1.0)),
    _benign("coarse-ranges", "ranges of 5 to 20 m", range_sigma_m=(5.0, 20.0)),
    _benign("lost-ranges", "each pair's ranges are lost for 5 to 15 s at a time", range_gap_s=(5.0, 15.0)),
    _benign("silence", "all ranges cease for 5 to 20 s, in turns", silence_s=(5.0, 20.0), bank_deg=(35.0, 50.0)),
    _benign("silence-no-air-data", "the same without attitude and airspeed", silence_s=(5.0, 20.0), bank_deg=(35.0, 50.0),
            has_air_data=False),
    _benign("denied-ranges-only", "ranges from the denied vehicle only", is_mutual=False),
    _benign("late-links", "links 0.1 to 0.5 s late, TIMESYNC answered", delay_s=(0.1, 0.5), jitter_s=(0.02, 0.15)),
    _benign("blackouts", "each vehicle's radio link is lost for seconds at a time, ranging goes on", blackout_s=(2.0, 6.0)),
    _benign("cold-start", "the denied vehicle never had a fix", lost_at_s=(-1.0, -1.0)),
    _benign("cold-start-far", "the same 15 to 40 km from the vehicle that sets the origin", lost_at_s=(-1.0, -1.0),
            from_origin_m=40_000.0),
    _benign("started-in-flight", "the service starts in flight, half a second of datagrams waiting", backlog_s=0.5,
            lost_at_s=(5.0, 20.0)),
    _benign("reboots", "vehicles fall silent and reboot in flight", reboots=True),
    _imperfect("common-gnss", "all receivers have 2 to 4 m of error in common", gnss_common_m=(2.0, 4.0),
               gnss_sigma_m=(0.5, 1.0)),
    _imperfect("optimistic-gnss", "receivers state a half to a third of their error", gnss_sigma_m=(2.0, 4.0),
               gnss_stated=(0.33, 0.5)),
    _imperfect("range-bias", "devices with lasting biases of up to 5 m", range_bias_m=(1.0, 5.0)),
    _imperfect("range-bias-denied-only", "the same, ranges from the denied vehicle only", range_bias_m=(1.0, 5.0),
               is_mutual=False),
    _imperfect("range-scale", "devices with scale errors of up to 1 %", range_scale=(0.003, 0.01)),
    _imperfect("student-ranges", "ranges with heavy tails", range_noise=RangeNoise.STUDENT),
    _imperfect("skewed-ranges", "ranges that are too long more often than too short", range_noise=RangeNoise.SKEWED),
    _imperfect("blocked-ranges", "pairs out of sight for seconds: 3 to 40 m too long", range_noise=RangeNoise.BLOCKED),
    _imperfect("blocked-denied-only", "the same with three or four peers, ranges from the denied vehicle only",
               range_noise=RangeNoise.BLOCKED, peers=(3, 4), is_mutual=False),
    _imperfect("copters-blocked", "pairs out of sight among copters", _COPTERS, range_noise=RangeNoise.BLOCKED),
    _imperfect("late-ranges", "ranges wait 0.2 to 0.9 s in companion computers with clocks of their own",
               companion_wait_s=(0.2, 0.9)),
    _imperfect("set-back-clock", "ranges are stamped by companions' clocks; the denied vehicle's is set back by 0.2 to 0.45 s",
               companion_set_back_s=(0.2, 0.45)),
    _imperfect("pair-detour", "all ranges of one pair of the denied vehicle are 10 to 150 m too long",
               pair_detour_m=(10.0, 150.0)),
    _imperfect("late-alike", "all links 0.2 to 0.6 s late, TIMESYNC not answered", delay_s=(0.2, 0.6), is_delay_alike=True,
               answers_timesync=False, has_utc=False),
    _imperfect("late-unequal", "links up to 0.5 s late, each its own, TIMESYNC not answered", delay_s=(0.02, 0.5),
               answers_timesync=False, has_utc=False),
    _imperfect("height", "barometers off by 5 to 20 m that drift", height_bias_m=(5.0, 20.0), height_drift_m=(2.0, 6.0)),
    _imperfect("gusts", "wind of 8 to 15 m/s with gusts of 2 to 4 m/s", wind_mps=(8.0, 15.0), gust_mps=(2.0, 4.0)),
    _imperfect("compass", "compasses off by 10 to 40 degrees", heading_error_deg=(10.0, 40.0)),
    _imperfect("pitot", "the denied vehicle's pitot tube is blocked, or leaks; all ranges cease for 5 to 20 s, in turns",
               pitot_fails=True, silence_s=(5.0, 20.0)),
    _imperfect("pitot-steep", "the same with three peers, planes bank by 55 to 65 degrees, no silence", pitot_fails=True,
               bank_deg=(55.0, 65.0), peers=(3, 3), is_mutual=False),
    _imperfect("frozen-attitude", "all ranges cease for 5 to 20 s, in turns, and the denied vehicle repeats its last attitude",
               attitude_freezes=True, silence_s=(5.0, 20.0), bank_deg=(35.0, 50.0)),
    _imperfect("barometer", "the denied vehicle's barometer jumps by 5 to 60 m", height_jump_m=(5.0, 60.0)),
    _fault("flicker", "jammed: the denied vehicle's fix comes back for seconds, up to 60 m off", flickers=True),
    _fault("spoofed-step", "one peer's receiver steps by 30 to 300 m", spoofing=_STEP),
    _fault("spoofed-step-denied-only", "the same, ranges from the denied vehicle only", spoofing=_STEP, is_mutual=False),
    _fault("spoofed-ramp", "one peer's receiver is drawn off at 0.2 to 5 m/s", spoofing=_RAMP),
    _fault("spoofed-ramp-denied-only", "the same, ranges from the denied vehicle only", spoofing=_RAMP, is_mutual=False),
    _fault("slow-telemetry-step", "one peer's receiver steps by 30 to 300 m, all telemetry every one to two seconds",
           spoofing=_STEP, telemetry_s=(1.0, 2.0), range_hz=(1.0, 2.0)),
    _fault("slow-telemetry-ramp", "one peer's receiver is drawn off at 0.2 to 5 m/s, the same telemetry", spoofing=_RAMP,
           telemetry_s=(1.0, 2.0), range_hz=(1.0, 2.0)),
    _fault("spoofed-airport", "one peer's receiver states a place 20 to 300 km away", spoofing=_AIRPORT),
    _fault("own-airport", "the vehicle's own receiver does", spoofing=replace(_AIRPORT, own=True)),
    _fault("two-alike-step", "two receivers step alike", spoofing=replace(_STEP, receivers=2), peers=(4, 5)),
    _fault("two-alike-ramp", "two receivers are drawn off alike", spoofing=replace(_RAMP, receivers=2), peers=(4, 5)),
    _fault("two-unlike-step", "two receivers step, each its own way", spoofing=replace(_STEP, receivers=2, is_alike=False)),
    _fault("two-unlike-ramp", "two receivers are drawn off, each its own way",
           spoofing=replace(_RAMP, receivers=2, is_alike=False)),
    _fault("two-alike-two-denied", "two receivers step alike, two vehicles denied", denied=2,
           spoofing=replace(_STEP, receivers=2), peers=(4, 5)),
    _fault("own-step", "the vehicle's own receiver steps by 30 to 300 m", spoofing=replace(_STEP, own=True)),
    _fault("own-ramp", "the vehicle's own receiver is drawn off", spoofing=replace(_RAMP, own=True)),
    _fault("device-step", "a ranging device steps by 5 to 30 m", device_step_m=(5.0, 30.0)),
    _fault("device-ramp", "a ranging device drifts by 0.1 to 1 m/s", device_ramp_mps=(0.1, 1.0)),
)  # fmt: skip

CLASSES: dict[str, FlightClass] = {drawn.name: drawn for drawn in _ALL}
"""All classes by name, in the order of the report."""
