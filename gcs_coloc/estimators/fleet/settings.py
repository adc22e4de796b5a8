"""Settings of the fleet filter: what it assumes of vehicles, sensors and links where the measurements do not show it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from gcs_coloc.core.setting_bounds import Bounds
from gcs_coloc.estimators.validation import check_settings


@dataclass(frozen=True, slots=True)
class FleetSettings:
    """Assumptions of the fleet filter. Sigmas are one standard deviation per axis, densities those of white acceleration noise.

    Raises:
        ValueError: a value is out of its bounds; the text names it.

    """

    RENAMED: ClassVar[dict[str, str]] = {
        "slow_density_m2ps3": "low_speed_density_m2ps3",
        "slow_speed_mps": "low_speed_mps",
        "unseen_climb_density_m2ps3": "unobserved_climb_density_m2ps3",
        "aided_density_m2ps3": "coordinated_turn_density_m2ps3",
        "turn_share": "turn_error_share",
        "least_slow_share": "least_coloured_share",
        "stamp_sigma_s": "time_stamp_offset_sigma_s",
        "stamp_error_time_s": "time_stamp_offset_time_s",
        "range_slow_share": "range_coloured_share",
        "range_slow_time_s": "range_coloured_time_s",
        "doubt_sigma": "huber_sigma",
        "peers_per_subject": "peers_per_denied_vehicle",
        "start_age_s": "initialisation_age_s",
    }
    """Names of version 0.1 and their new names."""

    window_s: Annotated[float, Bounds(0.0, 60.0)] = 1.0
    """s, 0 to 60. A measurement may arrive so long after it was measured; a later one is refused. Longer costs memory and longer
    replays. Chosen: telemetry radios at 57,600 baud delay by up to half a second."""
    ahead_s: Annotated[float, Bounds(0.0, 60.0)] = 0.5
    """s, 0 to 60. A time stamp may be so far ahead of the arrival. Chosen: the error of a clock that is not yet synchronised."""
    acceleration_density_m2ps3: Annotated[float, Bounds(1e-6, 1e3)] = 0.3
    """m^2/s^3, 1e-06 to 1000. Horizontal white acceleration in steady flight. Chosen: 0.5 m/s after a second, as of gusts."""
    low_speed_density_m2ps3: Annotated[float, Bounds(1e-6, 1e3)] = 1.0
    """m^2/s^3, 1e-06 to 1000. The same well below `low_speed_mps`, where a vehicle may move off to any side. Chosen: 1 m/s after
    a second, as of a multirotor."""
    low_speed_mps: Annotated[float, Bounds(1e-3, 1e3)] = 5.0
    """m/s, 0.001 to 1000. Speed at which the horizontal density is half way between the two. Chosen: below the stall speed of
    small aircraft."""
    climb_density_m2ps3: Annotated[float, Bounds(1e-6, 1e3)] = 0.02
    """m^2/s^3, 1e-06 to 1000. Vertical white acceleration in steady flight. Chosen: 0.14 m/s after a second, as of altitude
    hold."""
    unobserved_climb_density_m2ps3: Annotated[float, Bounds(1e-6, 1e3)] = 0.1
    """m^2/s^3, 1e-06 to 1000. The same of a fast denied vehicle without a height of its own. Chosen: a climb at 5 m/s is observed
    late; more costs accuracy in level flight."""
    manoeuvre_gain: Annotated[float, Bounds(1.0, 1e6)] = 300.0
    """Ratio, 1 to 1e+06. Most by which the manoeuvre detector inflates the process noise. Chosen: 300 * 0.3 m^2/s^3 is 9.5 m/s
    after a second, a turn at 1 g."""
    manoeuvre_memory_s: Annotated[float, Bounds(0.01, 600.0)] = 3.0
    """s, 0.01 to 600. Decay time of the manoeuvre detector. Chosen: shorter detects sooner and raises more false alarms."""
    turn_sigma_radps: Annotated[float, Bounds(1e-6, 10.0)] = 0.03
    """rad/s, 1e-06 to 10. Turn rate in steady flight. Chosen: 1.7 degrees a second, course corrections of an autopilot."""
    turn_time_s: Annotated[float, Bounds(0.01, 600.0)] = 3.0
    """s, 0.01 to 600. Correlation time of the turn rate. Chosen: a turn to a waypoint lasts some seconds."""
    coordinated_turn_density_m2ps3: Annotated[float, Bounds(1e-6, 1e3)] = 0.02
    """m^2/s^3, 1e-06 to 1000. Horizontal white acceleration beyond the turn that a fresh bank angle explains. Chosen: 0.14 m/s
    after a second."""
    turn_error_share: Annotated[float, Bounds(0.0, 1.0)] = 0.1
    """Share, 0 to 1. Error of the acceleration that the bank angle explains. Chosen: turns are coordinated to some 10 %."""
    wind_sigma_mps: Annotated[float, Bounds(1e-3, 100.0)] = 8.0
    """m/s, 0.001 to 100. Horizontal wind, each axis. Chosen: Beaufort 5, above which small aircraft stay on the ground."""
    wind_time_s: Annotated[float, Bounds(1.0, 1e6)] = 3600.0
    """s, 1 to 1e+06. Correlation time of the wind. Chosen: the mean wind of a place changes over an hour."""
    airspeed_sigma_mps: Annotated[float, Bounds(1e-3, 100.0)] = 1.0
    """m/s, 0.001 to 100. Coloured error of the airspeed. Chosen: a pitot tube calibrated to 5 % at 20 m/s."""
    heading_sigma_rad: Annotated[float, Bounds(1e-4, 3.0)] = 0.03
    """rad, 0.0001 to 3. Coloured error of the heading. Chosen: 1.7 degrees, a calibrated magnetometer."""
    air_error_time_s: Annotated[float, Bounds(0.01, 1e6)] = 600.0
    """s, 0.01 to 1e+06. Correlation time of the errors of airspeed and heading. Chosen: they change with temperature and
    course."""
    air_noise_mps: Annotated[float, Bounds(1e-3, 100.0)] = 0.5
    """m/s, 0.001 to 100. Fast part of the error of the air velocity: gusts, sideslip. Chosen: light turbulence."""
    air_noise_time_s: Annotated[float, Bounds(1e-3, 600.0)] = 0.5
    """s, 0.001 to 600. Correlation time of that noise. Chosen: 12 m of air at 25 m/s."""
    attitude_fresh_s: Annotated[float, Bounds(0.0, 600.0)] = 0.5
    """s, 0 to 600. An attitude holds for so long. Chosen: two lost messages at 4 Hz; a bank angle changes within a second."""
    report_error_time_s: Annotated[float, Bounds(0.01, 1e6)] = 100.0
    """s, 0.01 to 1e+06. Correlation time of the coloured error of position reports. Chosen: GNSS multipath and atmosphere drift
    over minutes."""
    least_coloured_share: Annotated[float, Bounds(1e-3, 1.0)] = 0.1
    """Share, 0.001 to 1. Least coloured part of a stated sigma, whatever the stream shows. Chosen: averaging ends somewhere."""
    baro_error_time_s: Annotated[float, Bounds(0.01, 1e6)] = 300.0
    """s, 0.01 to 1e+06. Correlation time of the error of barometric height. Chosen: pressure and temperature drift over
    minutes."""
    time_stamp_offset_sigma_s: Annotated[float, Bounds(1e-6, 10.0)] = 0.012
    """s, 1e-06 to 10. Time-stamp offset of a vehicle's own reports. Chosen: the age of a sample within an autopilot's loops."""
    time_stamp_offset_time_s: Annotated[float, Bounds(0.01, 1e6)] = 100.0
    """s, 0.01 to 1e+06. Correlation time of that offset. Chosen: it lasts longer than a manoeuvre."""
    range_bias_sigma_m: Annotated[float, Bounds(1e-6, 1e3)] = 0.01
    """m, 1e-06 to 1000. Bias of a ranging pair. Chosen: calibrated devices; more makes height and bias inseparable (see the
    accuracy results)."""
    range_bias_time_s: Annotated[float, Bounds(0.01, 1e6)] = 300.0
    """s, 0.01 to 1e+06. Correlation time of that bias. Chosen: it changes with temperature and antenna attitude."""
    range_coloured_share: Annotated[float, Bounds(0.0, 1.0)] = 0.6
    """Share, 0 to 1. Coloured error of a range, as a share of the part of its sigma not shown to be white. Chosen: multipath."""
    range_coloured_time_s: Annotated[float, Bounds(1e-3, 1e6)] = 1.0
    """s, 0.001 to 1e+06. Correlation time of that error. Chosen: multipath changes within some wavelengths of way."""
    gate_sigma: Annotated[float, Bounds(0.1, 100.0)] = 4.0
    """Sigmas, 0.1 to 100. An innovation beyond is refused. Chosen: one of 16,000 normal ones."""
    huber_sigma: Annotated[float, Bounds(0.1, 100.0)] = 2.0
    """Sigmas, 0.1 to 100. A range's innovation beyond pulls no harder than one of this size (Huber 1964). Chosen: costs 1 % of
    efficiency on normal noise."""
    peers_per_denied_vehicle: Annotated[int, Bounds(1, 250)] = 8
    """Count, 1 to 250. Most neighbours used at a time. Chosen: eight of 60 reach an HDOP below 0.75 of at best 0.707; the cost of
    a range grows with the square of the states."""
    peer_fresh_s: Annotated[float, Bounds(0.01, 600.0)] = 5.0
    """s, 0.01 to 600. A neighbour without a range for longer is not selected. Chosen: slow ranging at 0.2 Hz."""
    peer_kept_s: Annotated[float, Bounds(0.01, 3600.0)] = 30.0
    """s, 0.01 to 3600. A neighbour without a used range for longer leaves the joint state. Chosen: its correlation has
    decayed."""
    initialisation_age_s: Annotated[float, Bounds(0.01, 3600.0)] = 10.0
    """s, 0.01 to 3600. A position report older than this initialises nothing. Chosen: 250 m of flight at 25 m/s."""
    limit_sigma_m: Annotated[float, Bounds(0.01, 1e6)] = 200.0
    """m, 0.01 to 1e+06. Beyond this horizontal sigma (largest axis) there is no estimate. Chosen: no autopilot can use more."""

    def __post_init__(self) -> None:
        check_settings(self)
