"""Parameters that the doctor reads: their names, in which order to request them, and rules.

A parameter has all the names that it has had.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from gcs_coloc.core.aiding.methods.gps_input import DELAY_MS
from gcs_coloc.core.aiding.methods.px4_positions import AGP_CONTROL, AGP_ID, AGP_SLOTS, EV_CONTROL
from gcs_coloc.core.messages.inbound import Autopilot
from gcs_coloc.doctor.finding import Finding, Severity, right, stop

FORWARDS_UNKNOWN = 8
"""Bit of MAVn_OPTIONS: what arrives there and ArduPilot does not know, as PEER_RANGE, is forwarded and not dropped."""
STREAMS = ("POSITION", "EXT_STAT", "EXTRA1", "EXTRA2", "EXTRA3")
"""The ends of the names of ArduPilot's stream rates that hold what we want."""

_SERIAL_PORTS = range(8)
_MAVLINK_1 = 1.0  # of SERIALn_PROTOCOL; source: ArduPilot's parameter list
_MAVLINK = (_MAVLINK_1, 2.0, 43.0)  # 43: high latency, counted as the others
_INSTANCES = range(3)
_TELEM_PORTS = {101.0: 1, 102.0: 2, 103.0: 3}

Names = tuple[str, ...]
"""A parameter under all the names that it has had, the newest first."""


@dataclass(frozen=True, slots=True)
class SerialPort:
    """ArduPilot's serial port `number` that speaks MAVLink, the `channel`-th of those that do, from 0."""

    number: int
    channel: int
    is_mavlink_1: bool

    @property
    def protocol_name(self) -> str:
        """The name of the parameter that selects the port's protocol."""
        return f"SERIAL{self.number}_PROTOCOL"

    @property
    def baud_name(self) -> str:
        """The parameter with its baud rate, in thousands."""
        return f"SERIAL{self.number}_BAUD"

    @property
    def options_name(self) -> str:
        """The parameter with its options as a MAVLink port, of ArduPilot 4.7."""
        return f"MAV{self.channel + 1}_OPTIONS"

    def rate_names(self, stream: str) -> Names:
        """The parameter with the rate of one of its streams, Hz; ArduPilot 4.7 renamed it, and counts from 1."""
        return f"MAV{self.channel + 1}_{stream}", f"SR{self.channel}_{stream}"


@dataclass(frozen=True, slots=True)
class Instance:
    """PX4's MAVLink instance `number`, which is on.

    `telem` is the number of its TELEM port; None where it is on another port.
    """

    number: int
    telem: int | None

    @property
    def rate_name(self) -> str:
        """The name of the parameter with the most that it sends, bytes per second.

        Its value 0 is half of what the port's baud rate carries.
        """
        return f"MAV_{self.number}_RATE"

    @property
    def mode_name(self) -> str:
        """The parameter that selects what it sends of itself."""
        return f"MAV_{self.number}_MODE"

    @property
    def baud_name(self) -> str | None:
        """The parameter with its port's baud rate."""
        return f"SER_TEL{self.telem}_BAUD" if self.telem is not None else None


def serial_ports(told: Mapping[str, float]) -> list[SerialPort]:
    """Return an ArduPilot's serial ports with MAVLink, as far as it has sent their parameters."""
    speaking = [n for n in _SERIAL_PORTS if told.get(f"SERIAL{n}_PROTOCOL") in _MAVLINK]
    return [SerialPort(n, channel, told[f"SERIAL{n}_PROTOCOL"] == _MAVLINK_1) for channel, n in enumerate(speaking)]


def instances(told: Mapping[str, float]) -> list[Instance]:
    """Return a PX4's MAVLink instances that are on, as far as it has sent their parameters."""
    configs = {n: told.get(f"MAV_{n}_CONFIG", 0.0) for n in _INSTANCES}
    return [Instance(n, _TELEM_PORTS.get(config)) for n, config in configs.items() if config != 0.0]


def _names_of_ports(autopilot: Autopilot, told: Mapping[str, float]) -> list[Names]:
    """Return the parameters of its ports to request, by what it has sent so far."""
    if autopilot is Autopilot.ARDUPILOT:
        ports = serial_ports(told)
        return [
            *((f"SERIAL{n}_PROTOCOL",) for n in _SERIAL_PORTS),
            *(port.rate_names(stream) for port in ports for stream in STREAMS),
            *((name,) for port in ports for name in (port.baud_name, port.options_name)),
        ]
    if autopilot is Autopilot.PX4:
        on = instances(told)
        bauds = (instance.baud_name for instance in on)
        return [
            *((f"MAV_{n}_CONFIG",) for n in _INSTANCES),
            *((name,) for instance in on for name in (instance.rate_name, instance.mode_name)),
            *((name,) for name in bauds if name is not None),
        ]
    return []


GPS_TYPE = (("GPS1_TYPE", "GPS_TYPE"), ("GPS2_TYPE", "GPS_TYPE2"))
"""By receiver instance; the newest name first: ArduPilot 4.6 renamed them."""
GPS_PRIMARY = ("GPS_PRIMARY",)
GPS_AUTO_SWITCH = ("GPS_AUTO_SWITCH",)
GPS_CHECK = ("EK3_GPS_CHECK",)
CHECK_SCALE = ("EK3_CHECK_SCALE",)
POSITION_SOURCE = ("EK3_SRC1_POSXY",)
VELOCITY_SOURCE = ("EK3_SRC1_VELXY",)
VERTICAL_VELOCITY_SOURCE = ("EK3_SRC1_VELZ",)
HEIGHT_SOURCE = ("EK3_SRC1_POSZ",)
EKF_TYPE = ("AHRS_EKF_TYPE",)
SENDERS_OPTION = ("MAV_OPTIONS", "SYSID_ENFORCE")
"""Bit 0 of either: only the ground station's system ids are listened to. ArduPilot 4.7 renamed it."""
GCS_SYSID = ("MAV_GCS_SYSID", "SYSID_MYGCS")
GCS_SYSID_HIGH = ("MAV_GCS_SYSID_HI",)

AGP_BEFORE_1_18 = ("EKF2_AGP_CTRL",)
"""PX4's EKF2: what PX4 1.15 to 1.17 have in place of the slots of the auxiliary global position."""
AGP_DELAY = "EKF2_AGP{}_DELAY"
EV_NOISE_MODE = ("EKF2_EV_NOISE_MD",)
EV_DELAY = ("EKF2_EV_DELAY",)
EKF2_SOURCES = ("EKF2_SENS_EN",)
"""A bit for each sensor that EKF2 may fuse, since 2026."""
RANGING_BEACON_CONTROL = ("EKF2_RNGBC_CTRL",)
RANGING_BEACON_NOISE = ("EKF2_RNGBC_NOISE",)
RANGING_BEACON_DELAY = ("EKF2_RNGBC_DELAY",)

_ARDUPILOT = (
    *GPS_TYPE,
    GPS_AUTO_SWITCH,
    GPS_PRIMARY,
    SENDERS_OPTION,
    GCS_SYSID,
    GPS_CHECK,
    CHECK_SCALE,
    POSITION_SOURCE,
    VELOCITY_SOURCE,
    VERTICAL_VELOCITY_SOURCE,
    HEIGHT_SOURCE,
    EKF_TYPE,
    GCS_SYSID_HIGH,
    *DELAY_MS,
)
_PX4 = (
    *((name.format(0),) for name in (AGP_CONTROL, AGP_ID, AGP_DELAY)),
    (EV_CONTROL,),
    EV_NOISE_MODE,
    EV_DELAY,
    AGP_BEFORE_1_18,
    EKF2_SOURCES,
    RANGING_BEACON_CONTROL,
    RANGING_BEACON_NOISE,
    RANGING_BEACON_DELAY,
    *((name.format(slot),) for slot in AGP_SLOTS[1:] for name in (AGP_ID, AGP_CONTROL, AGP_DELAY)),
)
WANTED: Mapping[Autopilot, tuple[tuple[str, ...], ...]] = {Autopilot.ARDUPILOT: _ARDUPILOT, Autopilot.PX4: _PX4}
"""Those of aid; of its ports, `ports` knows."""

RETRY_S = 1.0  # chosen: longer than a telemetry radio takes there and back
MOST_TRIES = 6  # chosen: with half of the frames lost each way one of them gets through in 82 % of the cases
AT_ONCE = 8
"""Names asked for in one go: an answer to each fits into the buffers of a slow radio."""
OWN_TRIES = 3
"""Tries without any answer after which a vehicle is asked under the id that ground stations have by custom."""


def look_up(parameters: Mapping[str, float], names: tuple[str, ...]) -> tuple[str, float] | None:
    """The parameter that goes by one of `names`: the name that the vehicle has it under, and its value."""
    for name in names:
        if name in parameters:
            return name, parameters[name]
    return None


@dataclass(slots=True)
class ParameterReader:
    """Requests the parameters that one vehicle has not sent yet, a few at a time."""

    autopilot: Autopilot
    told: dict[str, float] = field(default_factory=dict)
    kinds: dict[str, int] = field(default_factory=dict)
    answers_as_gcs_only: bool = False
    _tries: dict[str, int] = field(default_factory=dict)
    _due_s: float = float("-inf")
    _rounds: int = 0

    def add(self, name: str, value: float, kind: int) -> None:
        """Add one parameter that the vehicle sent; `kind` is its MAV_PARAM_TYPE."""
        if not self.told and self.requests_as_gcs:
            self.answers_as_gcs_only = True
        self.told[name] = value
        self.kinds[name] = kind

    @property
    def requests_as_gcs(self) -> bool:
        """Whether the next requests are sent under a ground station's id, as ours gets no answer."""
        return self.answers_as_gcs_only or (not self.told and self._rounds > OWN_TRIES)

    def due(self, now_s: float) -> list[str]:
        """Return the names of the parameters to request by now."""
        if now_s < self._due_s:
            return []
        open_names = [
            name
            for names in (*WANTED.get(self.autopilot, ()), *_names_of_ports(self.autopilot, self.told))
            if look_up(self.told, names) is None
            for name in names
            if self._tries.get(name, 0) < MOST_TRIES
        ]
        # Those asked least often first, so that a parameter that the vehicle does not have holds nobody up.
        asked = sorted(open_names, key=lambda name: self._tries.get(name, 0))[:AT_ONCE]
        if asked:
            self._rounds += 1
            # Where answers come, the next names can follow soon.
            self._due_s = now_s + (RETRY_S if not self.told else RETRY_S / 2)
        for name in asked:
            self._tries[name] = self._tries.get(name, 0) + 1
        return asked


@dataclass(frozen=True, slots=True)
class ParameterRule:
    """One parameter that the vehicle needs for aiding."""

    names: tuple[str, ...]
    """The names that it has had, the newest first."""
    accepts: Callable[[float], bool]
    """Whether a value is right."""
    severity: Severity
    """How much another value matters."""
    wrong: str | Callable[[float], str]
    """What another value means, or how to say it of that value."""
    set_to: float | Callable[[float], float] | None = None
    """The right value, or how to get it from another one; None: there is nothing to set."""
    remedy_more: str = ""
    """What follows "set NAME = VALUE" in the remedy."""
    good: str | None = None
    """What a right value means; None: it is not told."""
    unreadable: str | None = None
    """What a parameter that could not be read may mean; None: the vehicle does without it."""


def equals(value: float) -> Callable[[float], bool]:
    """The predicate of exactly one right value."""
    return lambda found: found == value


def differs_from(value: float) -> Callable[[float], bool]:
    """The predicate of exactly one wrong value."""
    return lambda found: found != value


def apply_rules(parameters: Mapping[str, float], rules: Iterable[ParameterRule]) -> Iterator[Finding]:
    """Yield the findings of the rules on the parameters that a vehicle sent."""
    for rule in rules:
        found = look_up(parameters, rule.names)
        if found is None:
            if rule.unreadable is not None:
                yield stop(
                    f"{' or '.join(rule.names)} could not be read",
                    f"run the doctor again, nearer to the vehicle; else {rule.unreadable}",
                )
            continue
        name, value = found
        if rule.accepts(value):
            if rule.good is not None:
                yield right(f"{name} = {value:g}: {rule.good}")
            continue
        text = f"{name} = {value:g}: {rule.wrong if isinstance(rule.wrong, str) else rule.wrong(value)}"
        wanted = rule.set_to(value) if callable(rule.set_to) else rule.set_to
        if wanted is None:
            yield Finding(rule.severity, text)
        else:
            yield Finding(rule.severity, text, f"set {name} = {wanted:g}{rule.remedy_more}", (name, wanted))
