"""The settings of the measurements: their noise, the devices' calibration, and the oldest message."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from gcs_coloc.core.setting_bounds import check_bounds, positive
from gcs_coloc.core.stations.node_id import LARGEST_READ_SYSTEM_ID
from gcs_coloc.core.stations.stations import BeaconIds

_MOST_BIAS_M, _MOST_SCALE = 1000.0, 0.1  # chosen: beyond, it is another unit and no calibration


@dataclass(frozen=True, slots=True)
class MeasurementSettings:
    """Noise that the wire does not tell (1-sigma per axis), and how old a message may be."""

    position_sigma_h_m: float = positive(5.0)
    """Horizontal, of a receiver that states no accuracy; times its HDOP where that is more than 1.
    Chosen: the user range error of a code receiver without corrections."""
    position_sigma_v_m: float = positive(8.0)
    """Vertical, of a receiver that states no accuracy; times its HDOP where that is more than 1.
    Chosen: 1.6 times the horizontal one, as VDOP to HDOP."""
    velocity_sigma_mps: float = positive(0.5)
    """Of a receiver that states no speed accuracy. Chosen: a Doppler velocity in motion."""
    min_velocity_sigma_mps: float = positive(0.1)
    """No velocity counts as better than this. Chosen: the filter of a vehicle that stands states a centimetre a second or ten,
    for minutes, whatever its receiver states."""
    min_position_sigma_m: float = positive(0.3)
    """No receiver counts as better than this. Chosen: without RTK a smaller stated accuracy is optimistic."""
    range_sigma_m: float = positive(5.0)
    """Of a range that comes without one. Chosen: coarse enough for any ranging radio."""
    range_bias_m: Mapping[int, float] = field(default_factory=dict)
    """Lasting error of the ranging device of single vehicles by system id, m, as `4 = 0.25`; from `gcs-coloc calibrate`.
    A range of two vehicles is (1 + both scales) times the distance plus both biases."""
    range_scale: Mapping[int, float] = field(default_factory=dict)
    """Scale error of the ranging device of single vehicles by system id, as `4 = 0.002`: the excess over 1."""
    ranging_beacon_ids: BeaconIds = "stations"
    """Whose id the `beacon_id` of a RANGING_BEACON without a position is: a fixed station's, as MAVLink has it,
    or with `vehicles` the system id of a vehicle. With a position it is always a station's."""
    altitude_sigma_m: float = positive(2.0)
    """Of a barometric height. Chosen: its drift over a flight."""
    max_age_s: float = positive(5.0)
    """An older measurement is refused. Chosen: longer than any link's delay, shorter than a stamp from another clock."""

    def __post_init__(self) -> None:
        check_bounds(self)
        for name, most in (("range_bias_m", _MOST_BIAS_M), ("range_scale", _MOST_SCALE)):
            table: Mapping[int, float] = getattr(self, name)
            for sysid, value in table.items():
                if not 1 <= sysid <= LARGEST_READ_SYSTEM_ID:
                    raise ValueError(f"{name}: {sysid} is not a MAVLink system id (1 to {LARGEST_READ_SYSTEM_ID})")
                if not abs(value) <= most:
                    raise ValueError(f"{name}: {value:g} of vehicle {sysid} is not within {-most:g} to {most:g}")
