"""The settings of the fleet filter: what is assumed of vehicles, sensors and links where the measurements do not tell."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FleetSettings:
    """Assumptions of the fleet filter. Sigmas are one standard deviation per axis; densities are of white acceleration noise.

    Order: measurements may arrive up to `window_s` after they were measured, and be stamped up to `ahead_s` ahead of arrival.

    Motion: `acceleration_density_m2ps3` (horizontal, `slow_density_m2ps3` well below `slow_speed_mps`) and
    `climb_density_m2ps3` (vertical; towards `unseen_climb_density_m2ps3` the faster a vehicle flies whose own height nobody
    tells) hold in steady flight; up to `manoeuvre_gain` times as much does as far as the measurements
    ask for more velocity corrections, over `manoeuvre_memory_s`, than steady flight explains. The turn rate is a state, of
    `turn_sigma_radps` in steady flight, that lasts for `turn_time_s`. With a fresh bank angle `aided_density_m2ps3` holds beyond
    the turn that it explains, up to an error of `turn_share` of its sideways acceleration.

    Air data: `wind_sigma_mps` is the spread of the horizontal wind, which changes over `wind_time_s`; `airspeed_sigma_mps` and
    `heading_sigma_rad` are slow errors of airspeed and heading over `air_error_time_s`; `air_noise_mps` is their fast part
    (gusts, sideslip), correlated over `air_noise_time_s`. An attitude is used for `attitude_fresh_s`.

    Reports of position: the part of their error that is not seen to be white is slow, over `report_error_time_s`, and never
    less than `least_slow_share` of the stated sigma. A barometric height has the same treatment with `baro_error_time_s`.
    `stamp_sigma_s` is the error of time stamps, slow over `stamp_error_time_s` in one vehicle's reports.

    Ranges: each pair has a bias of `range_bias_sigma_m` that changes over `range_bias_time_s`, and as far as its ranges are not
    seen to scatter as stated, up to `range_slow_share` of the stated sigma comes again for `range_slow_time_s` (multipath,
    antennas). An innovation beyond `gate_sigma` is refused, one beyond `doubt_sigma` counts less.

    Peers: at most `peers_per_subject` neighbours are used, with ranges younger than `peer_fresh_s`; a neighbour that has not been
    ranged for `peer_kept_s` is dropped from the joint state.

    Honesty: a position older than `start_age_s` starts nothing; beyond `limit_sigma_m` (horizontal, largest axis) the
    position is unknown.
    """

    window_s: float = 1.0
    ahead_s: float = 0.5
    acceleration_density_m2ps3: float = 0.3
    slow_density_m2ps3: float = 1.0
    slow_speed_mps: float = 5.0
    climb_density_m2ps3: float = 0.02
    unseen_climb_density_m2ps3: float = 0.1
    manoeuvre_gain: float = 300.0
    manoeuvre_memory_s: float = 3.0
    turn_sigma_radps: float = 0.03
    turn_time_s: float = 3.0
    aided_density_m2ps3: float = 0.02
    turn_share: float = 0.1
    wind_sigma_mps: float = 8.0
    wind_time_s: float = 3600.0
    airspeed_sigma_mps: float = 1.0
    heading_sigma_rad: float = 0.03
    air_error_time_s: float = 600.0
    air_noise_mps: float = 0.5
    air_noise_time_s: float = 0.5
    attitude_fresh_s: float = 0.5
    report_error_time_s: float = 100.0
    least_slow_share: float = 0.1
    baro_error_time_s: float = 300.0
    stamp_sigma_s: float = 0.012
    stamp_error_time_s: float = 100.0
    range_bias_sigma_m: float = 0.01
    range_bias_time_s: float = 300.0
    range_slow_share: float = 0.6
    range_slow_time_s: float = 1.0
    gate_sigma: float = 4.0
    doubt_sigma: float = 2.0
    peers_per_subject: int = 8
    peer_fresh_s: float = 5.0
    peer_kept_s: float = 30.0
    start_age_s: float = 10.0
    limit_sigma_m: float = 200.0
