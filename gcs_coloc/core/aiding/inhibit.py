"""Why a vehicle is not aided, or is sent no fix: reasons to branch on, worded here alone."""

from __future__ import annotations

from gcs_coloc.core.reasons import StatedReason, WordedReason


class InhibitReason(WordedReason):
    """Why a vehicle cannot be aided, or may not be sent a fix."""

    # Nothing is sent
    NO_ROUTE = "no_route", "{detail}"
    NO_HEARTBEAT = "no_heartbeat", "no heartbeat of an autopilot heard yet"
    DUPLICATE_ID = "duplicate_id", "two autopilots use its system id; give each its own"
    HOST_CLOCK = "host_clock", "{detail}"
    UNKNOWN_AUTOPILOT = (
        "unknown_autopilot",
        "its autopilot is neither ArduPilot nor PX4: set its aiding method where you have tried one",
    )
    PX4_IGNORES_GPS_INPUT = "px4_ignores_gps_input", "PX4 does not take GPS_INPUT: set its aiding method to auto"
    ARDUPILOT_IGNORES_POSITION_SENSOR = (
        "ardupilot_ignores_position_sensor",
        "ArduPilot does not take GLOBAL_POSITION_SENSOR: set its method to auto",
    )
    FOREIGN_GPS_INPUT = "foreign_gps_input", "system {value:.0f} sends it GPS_INPUT for receiver {limit:.0f}"

    # No fix is claimed
    NOT_SENT_YET = "not_sent_yet", "not sent yet"
    NO_ESTIMATE = "no_estimate", "{detail}"
    BEYOND_ALERT_LIMIT = "beyond_alert_limit", "95 % horizontal bound {value:.0f} m is beyond the alert limit of {limit:g} m"
    PREDICTION_ALONE = "prediction_alone", "no range has been in use for {limit:g} s: prediction alone"
    UNDETERMINED = "undetermined", "its ranges, to one peer or along one line, have not fixed its place for {limit:g} s"
    RANGES_INCONSISTENT = "ranges_misfit", "half of its ranges are {value:.1f} sigma or more off where it is held to be"
    RANGES_JUMPED = "ranges_jumped", "all of its ranges jumped by {value:.0f} m"
    REGAINING = "regaining", "good enough again, watched for {limit:g} s"


Inhibit = StatedReason[InhibitReason]
"""Why a vehicle is not aided, with the numbers of it."""
