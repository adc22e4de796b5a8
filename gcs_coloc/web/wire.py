"""The wire format of the page's WebSocket as models; docs/reference/web.md describes every field."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, TypeAdapter

from gcs_coloc.core.alarms.alarms import Alarm, LightColour
from gcs_coloc.core.residual_log import RangeSnapshot
from gcs_coloc.core.snapshot import LinkSnapshot, OutSnapshot, VehicleSnapshot
from gcs_coloc.core.standby.standby_snapshot import StandbySnapshot
from gcs_coloc.core.station_review import StationSnapshot

HIDDEN = "hidden"
"""A page sends this when it goes out of sight, such as a tab behind others."""
VISIBLE = "visible"
"""A page sends this when it is in sight again."""
SHOWN = "shown"
"""A page acknowledges a `fleet` message with this once it is drawn; two are on their way to it at most."""
BOTH_SHOWN = "both shown"
"""A page acknowledges two `fleet` messages with this once both are drawn: for half the service's work."""


class _Wire(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


# Not frozen, as `VehicleSnapshot` is not: they are built many times a second and sent at once.
@dataclass(slots=True)
class Ellipse:
    """The 2-sigma ellipse of a horizontal position.

    `angle_rad` is that of its longer axis from east, counter-clockwise.
    """

    semi_major_m: float
    semi_minor_m: float
    angle_rad: float


@dataclass(slots=True)
class VehicleFrame:
    """One vehicle: its snapshot, its traffic light and the reason for that in words.

    `truth_enu_m` is its true position, from a simulation or a table, in the fleet's frame (m).
    """

    snapshot: VehicleSnapshot
    light: LightColour
    reason: str
    ellipse: Ellipse | None
    truth_enu_m: tuple[float, float, float] | None


@dataclass(frozen=True, slots=True)
class LinkFrame(LinkSnapshot):
    """Frames of one vehicle: totals since the start, and rate and loss over the last seconds.

    Rate and loss are None where they cannot be told yet.
    """

    rate_hz: float | None
    loss_percent: float | None


@dataclass(frozen=True, slots=True)
class OutFrame(OutSnapshot):
    """The ground tools behind one connection string: totals since the start, and frames a second lately."""

    rate_hz: float | None


class PlaybackState(_Wire):
    """The position in a replayed flight, sent with each picture of a replay. Times are UNIX seconds.

    `computed_s` is how far the flight is computed; `goal_s` is a position that is sought and not computed yet. `speed` None is as
    fast as the flight is computed. `command_count` counts the commands so far: by it a page sees whether this was sent before
    or after its own command.
    """

    kind: Literal["playback"] = "playback"
    first_s: float
    last_s: float
    at_s: float
    computed_s: float
    playing: bool
    speed: float | None
    goal_s: float | None
    command_count: int


class PlaybackCommand(_Wire):
    """A page's command to a replay; a field left out changes nothing.

    `halt` pauses and gives up a position that is sought.
    """

    halt: Literal[True] | None = None
    playing: bool | None = None
    speed: Annotated[float, Field(gt=0, allow_inf_nan=False)] | Literal["max"] | None = None
    seek_s: FiniteFloat | None = None


@dataclass(slots=True)
class FleetFrame:
    """The fleet at one instant, every 0.4 s (0.2 s in a replay); a page that is slow gets only the latest."""

    at_s: float
    utc_minus_service_s: float | None
    estimator: str
    origin: tuple[float, float, float] | None
    vehicles: tuple[VehicleFrame, ...]
    ranges: tuple[RangeSnapshot, ...]
    stations: tuple[StationSnapshot, ...]
    alarms: tuple[Alarm, ...]
    standby: StandbySnapshot | None = None
    kind: Literal["fleet"] = "fleet"


_FLEET_FRAME = TypeAdapter(FleetFrame)


def fleet_json(frame: FleetFrame) -> bytes:
    """A `FleetFrame` as JSON, without validation: its values come from the engine, many times a second."""
    return _FLEET_FRAME.dump_json(frame)


class CountsFrame(_Wire):
    """The counters, sent about once a second.

    They are of links, ground tools, refused messages, and measurements by what the estimator did with them.
    """

    kind: Literal["counts"] = "counts"
    links: tuple[LinkFrame, ...]
    outs: tuple[OutFrame, ...]
    refused: dict[str, int]
    estimator_counts: dict[str, int]


class Event(_Wire):
    """Something that happened; `alarm` where an alarm was raised by it."""

    id: int
    at_s: float
    sysid: int | None
    level: Literal["info", "warning", "error"]
    text: str
    alarm: bool


class EventsFrame(_Wire):
    """Events in order, each sent once.

    `missed` is how many were dropped from the service's memory before they could be sent.
    """

    kind: Literal["events"] = "events"
    events: tuple[Event, ...]
    missed: int


class VehicleHistory(_Wire):
    """One vehicle's last minutes, column by column, about one sample a second.

    None where a value was unknown.
    """

    sysid: int
    at_s: tuple[float, ...]
    east_m: tuple[float | None, ...]
    north_m: tuple[float | None, ...]
    sigma_h_m: tuple[float | None, ...]
    hdop: tuple[float | None, ...]
    ranges_in_use: tuple[float | None, ...]
    nis_median: tuple[float | None, ...]
    band_low: tuple[float | None, ...]
    band_high: tuple[float | None, ...]


class TilesInfo(_Wire):
    """The tiles under the map: their zoom levels (web Mercator scheme), and their attribution."""

    min_zoom: int
    max_zoom: int
    attribution: str


class Hello(_Wire):
    """The first message to a page.

    It has the run of the service, whether it accepts commands, whether it is a replay, and the last minutes.
    """

    kind: Literal["hello"] = "hello"
    instance: str
    version: str
    commands: bool
    replay: bool
    tiles: TilesInfo | None
    utc_minus_service_s: float | None
    history: tuple[VehicleHistory, ...]
