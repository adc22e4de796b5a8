"""Measurements of position from what a vehicle and its receiver report, with the noise that the receiver states or is assumed.

What was measured at an uncertain time was measured at an uncertain place: a position gets speed times time sigma as further
noise.
"""

from __future__ import annotations

from math import hypot
from typing import NamedTuple

from gcs_coloc.core.clocks.vehicle_clocks import ServiceTime
from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import PositionMeasurement
from gcs_coloc.core.messages.inbound import GlobalPosition, GpsReceiver
from gcs_coloc.core.telemetry.measurement_settings import MeasurementSettings


class ReceiverAccuracy(NamedTuple):
    """1-sigma per axis of a receiver: horizontal, vertical (m) and of its velocity (m/s)."""

    sigma_h_m: float
    sigma_v_m: float
    sigma_velocity_mps: float


def receiver_accuracy(receiver: GpsReceiver | None, settings: MeasurementSettings) -> ReceiverAccuracy:
    """Return the accuracy that a receiver states, and where it states none what the settings assume."""
    s = settings
    stated_h = receiver.h_acc_m if receiver is not None else None
    stated_v = receiver.v_acc_m if receiver is not None else None
    stated_speed = receiver.speed_acc_mps if receiver is not None else None
    # The error is that of one satellite's range times the dilution; the vertical one follows the horizontal one.
    dilution = max(receiver.hdop, 1.0) if receiver is not None and receiver.hdop is not None else 1.0
    sigma_h_m = max(stated_h, s.min_position_sigma_m) if stated_h is not None else s.position_sigma_h_m * dilution
    sigma_v_m = max(stated_v, s.min_position_sigma_m) if stated_v is not None else s.position_sigma_v_m * dilution
    return ReceiverAccuracy(sigma_h_m, sigma_v_m, stated_speed if stated_speed is not None else s.velocity_sigma_mps)


def measure_position(
    message: GlobalPosition | GpsReceiver,
    ned_mps: tuple[float, float, float],
    accuracy: ReceiverAccuracy,
    measured: ServiceTime,
    frame: LocalFrame,
) -> PositionMeasurement:
    """Build the measurement of a reported position at a velocity (north, east, down)."""
    vn_mps, ve_mps, vd_mps = ned_mps
    return PositionMeasurement(
        vehicle=message.sysid,
        measured_at_s=measured.at_s,
        arrived_at_s=message.received_at_s,
        position_enu_m=frame.enu_from_geodetic(message.lat_deg, message.lon_deg, message.alt_msl_m),
        sigma_h_m=hypot(accuracy.sigma_h_m, hypot(vn_mps, ve_mps) * measured.sigma_s),
        sigma_v_m=hypot(accuracy.sigma_v_m, vd_mps * measured.sigma_s),
        velocity_enu_mps=frame.enu_from_ned_velocity(message.lat_deg, message.lon_deg, ned_mps),
        sigma_velocity_mps=accuracy.sigma_velocity_mps,
        time_sigma_s=measured.sigma_s,
    )
