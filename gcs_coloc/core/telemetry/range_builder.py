"""The builder of range measurements from what ranging devices report.

It calibrates and times each range. It refuses the ranges of a device that is stuck, and those that have jumped.

What was measured at an uncertain time was measured at an uncertain place: a range gets the relative speed times time sigma as
further noise. It states that part apart as well, for an estimator that models clocks.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import hypot
from typing import NamedTuple

from gcs_coloc.core.clocks.vehicle_clocks import ServiceTime
from gcs_coloc.core.measurements import RangeMeasurement
from gcs_coloc.core.messages.inbound import PeerRange, TimeBase
from gcs_coloc.core.messages.outbound import Notice
from gcs_coloc.core.reasons import CoreRefusal
from gcs_coloc.core.stations.node_id import node_name
from gcs_coloc.core.stations.stations import Station
from gcs_coloc.core.telemetry.measurement_settings import MeasurementSettings
from gcs_coloc.core.telemetry.position_builder import receiver_accuracy
from gcs_coloc.core.telemetry.range_checks import RangeChecks
from gcs_coloc.core.telemetry.reported_state import ReportedState

_SIGMA_GAIN = 0.1  # of each range in the mean of late; chosen: it follows within about a second at 10 Hz


class BuiltRange(NamedTuple):
    """A range or the reason why it is refused, and the notice about its ranging device, if any."""

    measurement: RangeMeasurement | None
    notice: Notice | None = None
    refused: CoreRefusal | None = None


@dataclass(slots=True)
class RangeMemory:
    """What is kept of one vehicle's ranges.

    `checks` are those of its ranging devices. `sigma_m` is the 1-sigma of its ranges of late, whichever end measured them, with
    the errors of its peers' positions in it.
    """

    checks: RangeChecks = field(default_factory=RangeChecks)
    sigma_m: float | None = None

    def update_sigma(self, total_m: float) -> None:
        """Update the 1-sigma with that of one range, m."""
        before_m = self.sigma_m if self.sigma_m is not None else total_m
        self.sigma_m = before_m + _SIGMA_GAIN * (total_m - before_m)


def build_range(
    message: PeerRange,
    vehicle: tuple[ReportedState, RangeMemory],
    peer: tuple[ReportedState, RangeMemory] | Station,
    measured: ServiceTime,
    settings: MeasurementSettings,
) -> BuiltRange:
    """Build a range of a vehicle to another one or a station."""
    state, memory = vehicle
    peer_state = peer if isinstance(peer, Station) else peer[0]
    repeats = memory.checks.of(message.peer, message.device_id).repeats
    was_stuck, is_stuck = repeats.stuck, repeats.add(message.range_m, message.measured_at_s)
    notice = _device_notice(message, is_stuck=is_stuck) if is_stuck is not was_stuck else None
    if is_stuck:
        return BuiltRange(None, notice, CoreRefusal.RANGE_REPEATED)
    sigma_m = message.sigma_m if message.sigma_m is not None else settings.range_sigma_m
    # A range locates either end, whichever of the two measured it; a station is where it is.
    memory.update_sigma(hypot(sigma_m, _position_sigma_m(peer_state, settings)))
    if not isinstance(peer, Station):
        peer[1].update_sigma(hypot(sigma_m, _position_sigma_m(state, settings)))
    speed_mps, range_m = _relative_speed_mps(state, peer_state), _calibrated_m(message, peer_state, settings)
    late_m = speed_mps * measured.sigma_s
    sigma_m = hypot(sigma_m, late_m)
    if memory.checks.has_jumped(message.peer, message.device_id, measured.at_s, range_m, sigma_m, speed_mps):
        return BuiltRange(None, notice, CoreRefusal.RANGE_JUMPED)
    by_own_clock = message.measured_at_s is not None and message.time_base is not TimeBase.SERVICE
    measurement = RangeMeasurement(
        from_vehicle=message.sysid,
        to_vehicle=message.peer,
        measured_at_s=measured.at_s,
        arrived_at_s=message.received_at_s,
        range_m=range_m,
        sigma_m=sigma_m,
        device_id=message.device_id,
        clock_of=message.sysid if by_own_clock else None,
        time_sigma_s=measured.sigma_s,
        time_sigma_m=late_m,
    )
    return BuiltRange(measurement, notice)


def _position_sigma_m(node: ReportedState | Station, settings: MeasurementSettings) -> float:
    """Return the horizontal 1-sigma of where a vehicle says that it is, or where a station is, m."""
    if isinstance(node, Station):
        return node.position.sigma_h_m if node.position is not None else 0.0
    return receiver_accuracy(node.receiver, settings).sigma_h_m


def _calibrated_m(message: PeerRange, peer: ReportedState | Station, settings: MeasurementSettings) -> float:
    """Return the range without the lasting errors of both devices, as `gcs-coloc calibrate` finds them."""
    biases, scales = settings.range_bias_m, settings.range_scale
    of_station = (peer.range_bias_m, peer.range_scale) if isinstance(peer, Station) else (0.0, 0.0)
    if not biases and not scales and not any(of_station):
        return message.range_m
    ends = (message.sysid, message.peer)
    bias_m = sum(biases.get(end, 0.0) for end in ends) + of_station[0]
    scale = sum(scales.get(end, 0.0) for end in ends) + of_station[1]
    return max((message.range_m - bias_m) / (1.0 + scale), 0.0)


def _device_notice(message: PeerRange, *, is_stuck: bool) -> Notice:
    device, at_s = f"its ranging device {message.device_id}", message.received_at_s
    if is_stuck:
        text = f"{device} repeats one value, {message.range_m:.2f} m to {node_name(message.peer)}: it is stuck and not used"
        return Notice(at_s, message.sysid, "warning", text)
    return Notice(at_s, message.sysid, "info", f"{device} measures {node_name(message.peer)} again")


def _relative_speed_mps(vehicle: ReportedState, peer: ReportedState | Station) -> float:
    """Return the speed of two nodes against each other, the most by which a range changes per second.

    Where only one vehicle's velocity is known, or the other end is a station, it is that vehicle's own speed.
    """
    vn, ve, vd = (
        (vehicle.position.vn_mps, vehicle.position.ve_mps, vehicle.position.vd_mps) if vehicle.position else (0.0, 0.0, 0.0)
    )
    if isinstance(peer, ReportedState) and peer.position is not None:
        vn, ve, vd = vn - peer.position.vn_mps, ve - peer.position.ve_mps, vd - peer.position.vd_mps
    return hypot(vn, ve, vd)
