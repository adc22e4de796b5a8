"""Report of the doctor, as text for the operator and as JSON for programs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from gcs_coloc.core.aiding.methods.px4_positions import px4_method
from gcs_coloc.core.aiding.methods.registry import METHODS, method_for, mismatch
from gcs_coloc.core.aiding.settings import AidingMethodName
from gcs_coloc.core.messages.control import ALL_WOULD_USE_IT, OWN_ADDRESS
from gcs_coloc.core.messages.inbound import FIX_3D, Autopilot
from gcs_coloc.core.readiness.vehicle_readiness import LimitingReason, ReadinessState
from gcs_coloc.core.stations.node_id import is_station, node_name
from gcs_coloc.doctor import ardupilot_checks, px4_checks, stream_checks
from gcs_coloc.doctor.finding import Finding, FleetSurvey, Setup, Severity, VehicleSurvey, note, right, stop
from gcs_coloc.doctor.parameters import FORWARDS_UNKNOWN, SENDERS_OPTION, look_up, serial_ports
from gcs_coloc.mavlink.refusals import Refusal

_ORDER = (Severity.STOP, Severity.NOTE, Severity.RIGHT)
_MARKS = {Severity.STOP: "STOP ", Severity.NOTE: "note ", Severity.RIGHT: "right"}


class Report:
    """The doctor's findings on a fleet."""

    def __init__(self, survey: FleetSurvey, setup: Setup) -> None:
        fleet = frozenset(vehicle.sysid for vehicle in survey.vehicles) | survey.stations
        self._seconds = survey.seconds
        self._vehicles = [(vehicle, of_vehicle(vehicle, setup, fleet)) for vehicle in survey.vehicles]
        self._fleet = of_fleet(survey, setup)

    @property
    def is_ready(self) -> bool:
        """Whether nothing was found that would stop co-localisation."""
        return is_ready(self._fleet) and all(is_ready(findings) for _, findings in self._vehicles)

    def lines(self) -> Iterator[str]:
        """The report for reading: what stops first, and the result last."""
        for vehicle, findings in self._vehicles:
            yield f"vehicle {vehicle.sysid}: {vehicle.autopilot.value}, {'armed' if vehicle.armed else 'not armed'}"
            yield from _lines(findings)
        yield "fleet"
        yield from _lines(self._fleet)
        yield self._result()

    def as_json(self) -> dict[str, Any]:
        """The report as a JSON object, see docs/reference/command-line.md."""
        return {
            "seconds": self._seconds,
            "ready": self.is_ready,
            "vehicles": [
                {
                    "sysid": vehicle.sysid,
                    "autopilot": vehicle.autopilot.value,
                    "ready": is_ready(findings),
                    "findings": [_as_json(finding) for finding in findings],
                    "parameters": dict(sorted(vehicle.parameters.items())),
                }
                for vehicle, findings in self._vehicles
            ],
            "fleet": [_as_json(finding) for finding in self._fleet],
        }

    def _result(self) -> str:
        if self.is_ready:
            return "result: all right; co-localisation can work"
        stopped = [str(vehicle.sysid) for vehicle, findings in self._vehicles if not is_ready(findings)]
        whom = f"vehicle {', '.join(stopped)}" if stopped else "the fleet"
        return f"result: something would stop co-localisation of {whom}"


def _lines(findings: list[Finding]) -> Iterator[str]:
    for finding in sorted(findings, key=lambda finding: _ORDER.index(finding.severity)):
        yield f"  {_MARKS[finding.severity]}  {finding.text}{f'; {finding.remedy}' if finding.remedy else ''}"


def _as_json(finding: Finding) -> dict[str, Any]:
    name, value = finding.parameter if finding.parameter is not None else (None, None)
    return {
        "severity": finding.severity.value,
        "text": finding.text,
        "remedy": finding.remedy,
        "set": {name: value} if name else None,
    }


LEAST_PEERS = 3  # Source: Qu and Zhang, section III: trilateration needs three
CLOCKS_AGREE_S = 2.0  # chosen: beyond it the times of two logs cannot be put side by side by eye
OFTEN = 20  # chosen: within 15 s more than once a second: no accident
MUCH_BYTES = 200  # chosen: more than the rest of a frame that was cut off when listening began

_BETTER_PLACED = "see that in flight its peers stand around it: gcs-coloc plan tells where; or set up a station"
_HARMFUL: Mapping[Refusal, str] = {
    Refusal.UNSIGNED: "a link that requires signatures hears unsigned frames: give the vehicle the key",
    Refusal.SIGNATURE_WRONG: "a vehicle has another key than ours",
    Refusal.SIGNATURE_OLD: "a vehicle signs with a time over a minute behind this computer's: set one of the two clocks",
    Refusal.BAD_CRC: "frames arrive broken: a weak radio, a wrong baud rate, or two programs on one device",
}


def of_vehicle(vehicle: VehicleSurvey, setup: Setup, fleet: frozenset[int]) -> list[Finding]:
    """Return all findings on one vehicle.

    `fleet` are the nodes that are heard, or whose position is known.
    """
    findings = [*_identity(vehicle)]
    if not setup.denied or vehicle.sysid in setup.denied:
        findings += [*_address(vehicle, setup), *_autopilot(vehicle, setup), *_ranges(vehicle, fleet), *_readiness(vehicle)]
    else:
        findings.append(right("it is there to help locate others: whether it could be aided was not checked"))
    return [*findings, *stream_checks.check(vehicle), *_receiver(vehicle), *_clock(vehicle)]


def of_fleet(survey: FleetSurvey, setup: Setup) -> list[Finding]:
    """Return all findings on the fleet as a whole."""
    return [*_number(survey), *_denied(survey, setup), *_refused(survey), *_host(survey, setup)]


def is_ready(findings: list[Finding]) -> bool:
    """Whether none of the findings is on something that would stop co-localisation."""
    return all(finding.severity is not Severity.STOP for finding in findings)


_OWN_SYSID = "give every vehicle a system id of its own: SYSID_THISMAV, MAV_SYSID since ArduPilot 4.7, MAV_SYS_ID on PX4"


def _identity(vehicle: VehicleSurvey) -> Iterator[Finding]:
    if vehicle.is_claimed_twice:
        yield stop(
            f"its system id is used at {len(vehicle.addresses)} addresses at the same time: {', '.join(vehicle.addresses)}",
            _OWN_SYSID,
        )
    elif vehicle.has_two_clocks:
        yield stop("its boot times are those of two autopilots in turn: two use its system id", _OWN_SYSID)


def _address(vehicle: VehicleSurvey, setup: Setup) -> Iterator[Finding]:
    if vehicle.others_there and METHODS[_method(vehicle, setup)].heeds_target:
        yield right("it is aided by commands that it alone heeds, whoever shares its address")
    elif vehicle.others_there:
        others = ", ".join(str(sysid) for sysid in vehicle.others_there)
        yield stop(
            f"its address is also that of vehicle {others} (a router?), and {ALL_WOULD_USE_IT}",
            OWN_ADDRESS,
        )
    elif not vehicle.is_claimed_twice:
        yield right(f"it has an address of its own: {', '.join(vehicle.addresses)}")


def _method(vehicle: VehicleSurvey, setup: Setup) -> AidingMethodName:
    return method_for(vehicle.sysid, vehicle.autopilot, setup.aiding, lambda _: px4_method(vehicle.parameters.get))


def _autopilot(vehicle: VehicleSurvey, setup: Setup) -> Iterator[Finding]:
    way = _method(vehicle, setup)
    wrong_way = mismatch(way, vehicle.autopilot)
    # What a PX4 lacks to take any, its parameters show.
    if wrong_way is not None and (way != "auto" or vehicle.autopilot is not Autopilot.PX4):
        yield stop(wrong_way.text, f"set method, or methods.{vehicle.sysid} for this vehicle alone, in [aiding] of gcs-coloc")
        return
    if vehicle.autopilot not in (Autopilot.ARDUPILOT, Autopilot.PX4):
        yield note(
            f"its autopilot is neither ArduPilot nor PX4: it is aided by {way}, as set; whether it takes that, nobody knows"
        )
        return
    if not vehicle.parameters:
        signed = "; its frames are signed: give gcs-coloc its key" if vehicle.is_signed else ""
        yield stop(
            "it is heard and answers nothing, so its parameters are not checked",
            f"see that the link goes both ways and that it listens to us (its parameters, signing){signed}",
        )
        return
    if vehicle.answers_only_to is not None and look_up(vehicle.parameters, SENDERS_OPTION) is None:
        yield stop(
            f"it answers {vehicle.answers_only_to} and not us, {setup.system_id}",
            f"set system_id = {vehicle.answers_only_to} in [mavlink] of gcs-coloc",
        )
    if vehicle.autopilot is Autopilot.PX4:
        yield from px4_checks.check(vehicle, way)
    else:
        yield from ardupilot_checks.check(vehicle, setup, way)


def _ranges(vehicle: VehicleSurvey, fleet: frozenset[int]) -> Iterator[Finding]:
    known, strangers = sorted(vehicle.peers & fleet), sorted(vehicle.peers - fleet)
    listed = ", ".join(map(node_name, sorted(known, key=lambda node: (is_station(node), abs(node)))))
    if stations := [node_name(node) for node in reversed(strangers) if is_station(node)]:
        remedy = 'give them a [[station]] each; where they are vehicles, set ranging_beacon_ids = "vehicles" in [measurements]'
        yield note(f"ranges to {', '.join(stations)}, whose position nobody tells: of no use", remedy)
    if vehicles := [str(node) for node in strangers if not is_station(node)]:
        yield note(f"ranges to {', '.join(vehicles)}, which are not heard: of no use unless they tell where they are")
    if vehicle.has_unstamped_ranges:
        yield note(
            "its ranges have no time stamp: in fast flight a late one is metres off, and sound vehicles may be suspected",
            "fill in when each range was measured (time_usec; time_boot_ms of NAMED_VALUE_FLOAT)",
        )
    if len(known) >= LEAST_PEERS:
        yield right(f"ranges to {len(known)} others: {listed}")
        return
    yield stop(
        f"ranges to {len(known)} of the {LEAST_PEERS} others that are needed to locate it" + (f": {listed}" if known else ""),
        "see that its ranging device is on and reports PEER_RANGE with the peers' system ids"
        f"{_forwarding(vehicle)}; or say with --aid which vehicles are to be located",
    )


def _readiness(vehicle: VehicleSurvey) -> Iterator[Finding]:
    """Yield the finding on the readiness that the engine computes from the vehicle's ranges.

    There is none without ranges, or where the set-up prevents aiding: the other checks report that.
    """
    found = vehicle.readiness
    if found is None or not found.peers or found.reason == LimitingReason.NOT_AIDED.code:
        return
    if found.state is ReadinessState.UNKNOWN:
        yield note(f"whether it would be located if its GPS failed is not told: {found.text}")
        return
    levels = f" within {found.bound_95_m:.1f} m (95 %), protection level {found.hpl_m:.0f} m" if found.hpl_m is not None else ""
    here = "if its GPS failed where all of them are now"
    if found.state is ReadinessState.READY:
        yield right(f"{here} it would be located{levels}")
    elif found.state is ReadinessState.DEGRADED:
        yield note(f"{here} it would be located{levels}, but {found.text}", _BETTER_PLACED)
    else:
        yield note(f"{here} it would be lost: {found.text}", _BETTER_PLACED)


def _forwarding(vehicle: VehicleSurvey) -> str:
    """What keeps a companion's ranges from us on their way through the autopilot."""
    if vehicle.autopilot is Autopilot.PX4:
        return ", on a link of its own: PX4 forwards RANGING_BEACON and DEBUG_VECT, and not PEER_RANGE"
    names = [port.options_name for port in serial_ports(vehicle.parameters)]
    dropping = [name for name in names if not int(vehicle.parameters.get(name, FORWARDS_UNKNOWN)) & FORWARDS_UNKNOWN]
    if vehicle.autopilot is not Autopilot.ARDUPILOT or not dropping:
        return ""
    wanted = (f"{name} = {int(vehicle.parameters[name]) | FORWARDS_UNKNOWN}" for name in dropping)
    remedy = f"set {' or '.join(wanted)} on that port and reboot it, or send DEBUG_VECT"
    return f"; from a companion's port ArduPilot drops it: {remedy}"


def _receiver(vehicle: VehicleSurvey) -> Iterator[Finding]:
    receiver = vehicle.receiver
    if receiver is None:
        return
    satellites = f", {receiver.satellites} satellites" if receiver.satellites is not None else ""
    if receiver.fix_type >= FIX_3D:
        yield right(f"its GPS has a fix (type {receiver.fix_type}{satellites})")
    else:
        yield note(f"its GPS has no 3D fix now (fix type {receiver.fix_type}{satellites})")


def _clock(vehicle: VehicleSurvey) -> Iterator[Finding]:
    if not vehicle.answers_timesync:
        yield note(
            "it does not answer TIMESYNC: what it measures is placed in time by its UTC, to 0.1 s, where it has GPS and this "
            "computer's clock is synchronised, else by its arrival: set min_delay_s in [time] where you know its link's delay"
        )
    off_s = vehicle.utc_minus_host_s
    if off_s is not None and abs(off_s) > CLOCKS_AGREE_S:
        where = "ahead of" if off_s > 0 else "behind"
        yield note(
            f"its UTC is {abs(off_s):.0f} s {where} this computer's: ranges with UNIX times are misplaced, signatures refused",
            "set this computer's clock (timedatectl)",
        )


def _number(survey: FleetSurvey) -> Iterator[Finding]:
    heard = len(survey.vehicles)
    garbage_bytes = survey.refused.get(Refusal.GARBAGE_BYTES, 0)
    if heard == 0 and garbage_bytes >= MUCH_BYTES:
        yield stop(
            f"no vehicle was heard in {survey.seconds:g} s, but {garbage_bytes} bytes that are no MAVLink",
            "see that a serial link has the radio's baud rate (serial:DEVICE:BAUD), and that no other program sends here",
        )
    elif heard == 0:
        yield stop(
            f"no vehicle was heard in {survey.seconds:g} s",
            "see that a vehicle is on and sends here: on a network to this computer's address and this port, with no firewall in "
            "between; on a serial device through a radio that is linked",
        )
    elif heard + len(survey.stations) <= LEAST_PEERS:
        yield stop(f"vehicles heard: {heard}; to locate one, {LEAST_PEERS} others are needed that know where they are")
    else:
        stations = f", fixed stations with a position: {len(survey.stations)}" if survey.stations else ""
        yield right(f"vehicles heard: {heard}{stations}")


def _denied(survey: FleetSurvey, setup: Setup) -> Iterator[Finding]:
    for sysid in sorted(setup.denied - {vehicle.sysid for vehicle in survey.vehicles}):
        yield stop(f"vehicle {sysid}, which is to be located, was not heard")


def _refused(survey: FleetSurvey) -> Iterator[Finding]:
    for reason, text in _HARMFUL.items():
        times = survey.refused.get(reason, 0)
        if times >= OFTEN:
            yield note(f"{times} times refused ({reason}): {text}")


def _host(survey: FleetSurvey, setup: Setup) -> Iterator[Finding]:
    if survey.host_is_synchronised is False:
        finding = stop if setup.requires_synchronised_clock else note
        yield finding("this computer's clock is not synchronised (NTP, GPS)", "switch it on: timedatectl set-ntp true")
