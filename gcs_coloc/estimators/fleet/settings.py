"""Settings of the fleet filter.

What it assumes of vehicles, sensors and links where the measurements do not show it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final, Literal

from gcs_coloc.core.setting_bounds import between, check_bounds

BY_REPORT: Final = "reported"
"""The setting `vehicle_class` that leaves the class to what is reported of each vehicle."""


@dataclass(frozen=True, slots=True)
class FleetSettings:
    """Assumptions of the fleet filter.

    Sigmas are one standard deviation per axis, densities those of white acceleration noise.

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

    window_s: float = between(1.0, 0.0, 60.0)
    """s. A measurement may arrive so long after it was measured. A later one is refused; a position that is later by at most
    3 s counts where its velocity has led when the window begins. Longer costs memory and longer replays. Chosen: telemetry
    radios at 57,600 baud delay by up to half a second, and by more at times."""
    ahead_s: float = between(0.5, 0.0, 60.0)
    """s. A time stamp may be so far ahead of the arrival. Chosen: the error of a clock that is not yet synchronised."""
    acceleration_density_m2ps3: float = between(0.3, 1e-6, 1e3)
    """m^2/s^3. Horizontal white acceleration in steady flight. Chosen: 0.5 m/s after a second, as of gusts."""
    low_speed_density_m2ps3: float = between(1.0, 1e-6, 1e3)
    """m^2/s^3. The same well below `low_speed_mps`, where a vehicle may move off to any side. Chosen: 1 m/s after
    a second, as of a multirotor."""
    low_speed_mps: float = between(5.0, 1e-3, 1e3)
    """m/s. Speed at which the horizontal density is half way between the two. Chosen: below the stall speed of
    small aircraft."""
    climb_density_m2ps3: float = between(0.02, 1e-6, 1e3)
    """m^2/s^3. Vertical white acceleration in steady flight, 15 times as much of a multirotor whose height is
    measured. Chosen: 0.14 m/s after a second, as of altitude hold."""
    unobserved_climb_density_m2ps3: float = between(0.1, 1e-6, 1e3)
    """m^2/s^3. The same of a fast denied vehicle without a height of its own. Chosen: a climb at 5 m/s is observed
    late; more costs accuracy in level flight."""
    manoeuvre_gain: float = between(300.0, 1.0, 1e6)
    """Ratio. Most by which the manoeuvre detector inflates the process noise. Chosen: 300 * 0.3 m^2/s^3 is 9.5 m/s
    after a second, a turn at 1 g."""
    manoeuvre_memory_s: float = between(3.0, 0.01, 600.0)
    """s. Decay time of the manoeuvre detector. Chosen: shorter detects sooner and raises more false alarms."""
    vehicle_class: Literal["reported", "plane", "multirotor", "ground", "boat", "indoor"] = BY_REPORT
    """Class of every vehicle, which sets what it does at most; `reported`: as its HEARTBEAT or `meta.toml`
    says. Chosen: vehicles of one fleet differ."""
    max_speed_mps: float | None = between(None, 0.1, 1e3)
    """m/s. Largest horizontal speed of every vehicle; that of its class if none. Chosen: a class is all that is reported."""
    max_acceleration_mps2: float | None = between(None, 0.1, 1e3)
    """m/s^2. Largest horizontal acceleration of every vehicle; that of its class if none. Chosen: as the speed."""
    turn_sigma_radps: float = between(0.03, 1e-6, 10.0)
    """rad/s. Turn rate in steady flight. Chosen: 1.7 degrees a second, course corrections of an autopilot."""
    turn_time_s: float = between(3.0, 0.01, 600.0)
    """s. Correlation time of the turn rate. Chosen: a turn to a waypoint lasts some seconds."""
    coordinated_turn_density_m2ps3: float = between(0.3, 1e-6, 1e3)
    """m^2/s^3. Horizontal white acceleration beyond the turn that a fresh bank angle explains, until its level is learned.
    Chosen: 0.5 m/s after a second, as of light gusts."""
    noise_level_time_s: float = between(20.0, 0.1, 1e4)
    """s. In so long corrections of twice their predicted variance raise the learned noise level e-fold. Chosen: the level then
    scatters by 40 %, and halves or doubles within half a minute."""
    least_noise_level: float = between(0.067, 1e-6, 1.0)
    """Ratio. Least learned level of gusts: factor of `coordinated_turn_density_m2ps3` and of the variance of `air_noise_mps`.
    Chosen: 0.02 m^2/s^3, still air."""
    most_noise_level: float = between(30.0, 1.0, 1e4)
    """Ratio. Most learned level of gusts. Chosen: 9 m^2/s^3, gusts of 4 m/s that last 4 s."""
    turn_error_share: float = between(0.1, 0.0, 1.0)
    """Share. Error of the acceleration that the bank angle explains. Chosen: turns are coordinated to some 10 %."""
    wind_sigma_mps: float = between(8.0, 1e-3, 100.0)
    """m/s. Horizontal wind, each axis. Chosen: Beaufort 5, above which small aircraft stay on the ground."""
    wind_time_s: float = between(3600.0, 1.0, 1e6)
    """s. Correlation time of the wind. Chosen: the mean wind of a place changes over an hour."""
    airspeed_sigma_mps: float = between(1.0, 1e-3, 100.0)
    """m/s. Coloured error of the airspeed. Chosen: a pitot tube calibrated to 5 % at 20 m/s."""
    heading_sigma_rad: float = between(0.03, 1e-4, 3.0)
    """rad. Coloured error of the heading. Chosen: 1.7 degrees, a calibrated magnetometer."""
    air_error_time_s: float = between(600.0, 0.01, 1e6)
    """s. Correlation time of the errors of airspeed and heading. Chosen: they change with temperature and
    course."""
    air_noise_mps: float = between(0.8, 1e-3, 100.0)
    """m/s. Fast part of the error of the air velocity, gusts and sideslip, until its level is learned. Chosen: light
    turbulence."""
    air_noise_time_s: float = between(2.0, 1e-3, 600.0)
    """s. Correlation time of that noise. Chosen: 40 m of air at 20 m/s, the scale of gusts near the ground."""
    attitude_fresh_s: float = between(0.5, 0.0, 600.0)
    """s. An attitude holds for so long. Chosen: two lost messages at 4 Hz; a bank angle changes within a second."""
    report_error_time_s: float = between(100.0, 0.01, 1e6)
    """s. Correlation time of the coloured error of position reports. Chosen: GNSS multipath and atmosphere drift
    over minutes."""
    least_coloured_share: float = between(0.1, 1e-3, 1.0)
    """Share. Least coloured part of a stated sigma, whatever the stream shows. Chosen: averaging ends somewhere."""
    baro_error_time_s: float = between(300.0, 0.01, 1e6)
    """s. Correlation time of the error of barometric height. Chosen: pressure and temperature drift over
    minutes."""
    time_stamp_offset_sigma_s: float = between(0.02, 1e-6, 10.0)
    """s. Time-stamp offset of a vehicle's own reports, against those of its ranges. Chosen: one cycle of a 50 Hz loop;
    recorded ArduPlanes have 0.03 s between positions and ranges."""
    time_stamp_offset_time_s: float = between(100.0, 0.01, 1e6)
    """s. Correlation time of that offset. Chosen: it lasts longer than a manoeuvre."""
    range_bias_sigma_m: float = between(0.01, 1e-6, 1e3)
    """m. Bias of a ranging pair. Chosen: calibrated devices; more makes height and bias inseparable
    (docs/results/accuracy.md)."""
    range_bias_time_s: float = between(300.0, 0.01, 1e6)
    """s. Correlation time of that bias. Chosen: it changes with temperature and antenna attitude."""
    unknown_device_bias_m: float = between(0.2, 0.0, 1e3)
    """m. Bias that the device of a denied vehicle may have on all its ranges, until these show one or rule it out; 0:
    calibrated. Chosen: 0.14 to 0.28 m in public sets of uncalibrated ultra-wideband radios (docs/results/ranging.md)."""
    unknown_pair_bias_m: float = between(0.07, 0.0, 1e3)
    """m. What each pair may be off beyond that, for ten seconds or for ever. Chosen: 0.04 to 0.09 m in the same sets."""
    range_coloured_share: float = between(0.6, 0.0, 1.0)
    """Share. Coloured error of a range, as a share of the part of its sigma not shown to be white. Chosen: multipath."""
    range_coloured_time_s: float = between(1.0, 1e-3, 1e6)
    """s. Correlation time of that error. Chosen: multipath changes within some wavelengths of way."""
    gate_sigma: float = between(4.0, 0.1, 100.0)
    """Sigmas. An innovation beyond is refused. Chosen: one of 16,000 normal ones."""
    huber_sigma: float = between(2.0, 0.1, 100.0)
    """Sigmas. A range's innovation beyond pulls no harder than one of this size (Huber 1964). Chosen: costs 1 % of
    efficiency on normal noise."""
    peers_per_denied_vehicle: int = between(8, 1, 250)
    """Count. Most neighbours used at a time. Chosen: eight of 60 reach an HDOP below 0.75 of at best 0.707; the cost of
    a range grows with the square of the states."""
    peer_fresh_s: float = between(5.0, 0.01, 600.0)
    """s. A neighbour without a range for longer is not selected. Chosen: slow ranging at 0.2 Hz."""
    peer_kept_s: float = between(30.0, 0.01, 3600.0)
    """s. A neighbour without a used range for longer leaves the joint state. Chosen: its correlation has
    decayed."""
    initialisation_age_s: float = between(10.0, 0.01, 3600.0)
    """s. A position report older than this initialises nothing. Chosen: 250 m of flight at 25 m/s."""
    limit_sigma_m: float = between(200.0, 0.01, 1e6)
    """m. Beyond this horizontal sigma (largest axis) there is no estimate. Chosen: no autopilot can use more."""

    def __post_init__(self) -> None:
        check_bounds(self)
