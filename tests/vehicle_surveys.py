"""What the doctor finds at a vehicle that is set up right, to be changed, and what it says of a vehicle."""

from __future__ import annotations

from dataclasses import replace

from gcs_coloc.core.messages.inbound import Autopilot, GpsReceiver
from gcs_coloc.core.telemetry.stream_requests import wanted_hz
from gcs_coloc.doctor.finding import Setup, Severity, VehicleSurvey
from gcs_coloc.doctor.report import of_vehicle
from gcs_coloc.mavlink.encoder import STREAM_IDS

WANTED_HZ = {STREAM_IDS[stream]: hz for autopilot in Autopilot for stream, hz in wanted_hz(autopilot).items()}

PARAMETERS = {
    "GPS1_TYPE": 1.0,
    "GPS2_TYPE": 14.0,
    "GPS_PRIMARY": 0.0,
    "GPS_AUTO_SWITCH": 4.0,
    "GPS1_DELAY_MS": 0.0,
    "GPS2_DELAY_MS": 100.0,
    "EK3_GPS_CHECK": 31.0,
    "EK3_CHECK_SCALE": 150.0,
    "EK3_SRC1_POSXY": 3.0,
    "EK3_SRC1_VELXY": 3.0,
    "EK3_SRC1_VELZ": 0.0,
    "EK3_SRC1_POSZ": 1.0,
    "AHRS_EKF_TYPE": 3.0,
    "MAV_OPTIONS": 0.0,
    "MAV_GCS_SYSID": 255.0,
    "MAV_GCS_SYSID_HI": 0.0,
}
PX4_SLOT = {"EKF2_AGP0_CTRL": 1.0, "EKF2_AGP0_ID": 1.0, "EKF2_AGP0_DELAY": 0.0}
RECEIVER = GpsReceiver(4, 10.0, 0, 3, 47.0, 8.0, 500.0, 12, 0.8, 0.9, 1.2, 0.2)
GOOD = VehicleSurvey(
    sysid=4,
    autopilot=Autopilot.ARDUPILOT,
    armed=True,
    addresses=("127.0.0.1:5000 on udpin:0.0.0.0:14550",),
    parameters=PARAMETERS,
    rates_hz=dict(WANTED_HZ),
    receiver=RECEIVER,
    peers=frozenset({1, 2, 3}),
    answers_timesync=True,
    utc_minus_host_s=0.1,
)

FLEET = frozenset({1, 2, 3, 4})


def said(vehicle, setup=None, fleet=FLEET):
    return [finding for finding in of_vehicle(vehicle, setup or Setup(), fleet) if finding.severity is not Severity.RIGHT]


def with_parameters(**changes):
    return replace(GOOD, parameters={k: v for k, v in (PARAMETERS | changes).items() if v is not None})
