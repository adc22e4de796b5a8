"""Why the service holds a vehicle's GPS to be as it is: reasons with their numbers, worded here alone."""

from __future__ import annotations

from gcs_coloc.core.reasons import DUPLICATE_ID_WORDING, WordedReason


class GpsReason(WordedReason):
    """What speaks for a state of GPS health."""

    # Faults, the worst first
    DUPLICATE_ID = "duplicate_id", DUPLICATE_ID_WORDING
    NO_FIX = "no_fix", "no 3D fix: fix type {value:.0f}"
    FEW_SATELLITES = "few_satellites", "only {value:.0f} satellites"
    POOR_ACCURACY = "poor_accuracy", "horizontal accuracy {value:.0f} m is worse than {limit:g} m"
    FROZEN = "frozen", "its receiver repeats one position while the vehicle moved {value:.0f} m"
    SPOOFING_REPORTED = "spoofing_reported", "its receiver reports spoofing"
    SPOOFING_INDICATED = "spoofing_indicated", "its receiver reports signs of spoofing"
    JAMMING_REPORTED = "jamming_reported", "its receiver reports jamming"
    RAIM_FAILED = "raim_failed", "its receiver's own integrity test (RAIM) failed"
    SILENT = "silent", "no GPS_RAW_INT for more than {limit:g} s"
    CONTRADICTED_BY_RANGES = "contradicted_by_ranges", "{detail}"
    IMPLAUSIBLE_MOTION = "implausible_motion", "its position moved {value:.0f} m other than its velocity within {limit:g} s"
    OFF_ITS_RECEIVER = "off_its_receiver", "the position that it reports is {value:.0f} m off its own receiver's"
    SYSTEM_UNHEALTHY = "system_unhealthy", "SYS_STATUS: GPS not healthy"
    EKF_GLITCH = "ekf_glitch", "the autopilot's EKF reports a GPS glitch"
    EKF_NOT_ABSOLUTE = "ekf_not_absolute", "the autopilot's EKF has no absolute position"

    # No faults
    NOTHING_HEARD = "nothing_heard", "nothing heard from its GPS receiver yet"
    OVERRIDDEN = "overridden", "declared {detail} by the operator"
    FIX = "fix", "{detail}"
    RETURNING = "returning", "{detail}: back, not for {limit:g} s without a break yet"
    RETURNED = "returned", "{detail}: back, watched for {limit:g} s"
    RETURNED_UNTESTED = "returned_untested", "{detail}: back, watched for {limit:g} s; nothing to hold it against"
    RETURN_CONTRADICTED = "return_contradicted", "{detail}: back, but ranges to it do not fit"
    RECOVERED_UNTESTED = "recovered_untested", "{detail}; nothing to hold it against"
