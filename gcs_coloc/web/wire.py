"""What the page is sent over its WebSocket, as models: docs/reference/web.md describes every field."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, TypeAdapter

from gcs_coloc.core.snapshot import RangeSnapshot, VehicleSnapshot

HIDDEN = "hidden"
"""What a page sends when nobody looks at it any more; anything else says that somebody does."""

LightColour = Literal["good", "caution", "bad", "unknown"]


class _Wire(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


# Not frozen, as `VehicleSnapshot` is not: the page's values are made many times a second, and sent at once.
@dataclass(slots=True)
class Ellipse:
    """The 2-sigma ellipse of a horizontal position; `angle_rad` of its longer axis from east, counter-clockwise."""

    semi_major_m: float
    semi_minor_m: float
    angle_rad: float


@dataclass(slots=True)
class VehicleFrame:
    """One vehicle: the service's view of it, its traffic light and the reason for that in words.

    `truth_enu_m` is where a simulation says that it truly is, in the fleet's frame (m).
    """

    view: VehicleSnapshot
    light: LightColour
    reason: str
    ellipse: Ellipse | None
    truth_enu_m: tuple[float, float, float] | None


class LinkFrame(_Wire):
    """Frames of one vehicle: totals since the start, and rate and loss over the last seconds (None until known)."""

    sysid: int
    received: int
    lost: int
    duplicates: int
    rate_hz: float | None
    loss_percent: float | None


class OutFrame(_Wire):
    """The ground tools behind one connection string: how many now, totals, and frames handed on a second (None until known)."""

    name: str
    tools: int
    frames_sent: int
    frames_accepted: int
    dropped: int
    refused: int
    rate_hz: float | None


class PlaybackState(_Wire):
    """Where a replayed flight is: UNIX seconds; `speed` None is as fast as it goes, `goal_s` where it is on its way to.

    `obeyed` counts the commands so far: a page tells by it whether this was said before its own command or after.
    """

    first_s: float
    last_s: float
    at_s: float
    playing: bool
    speed: float | None
    goal_s: float | None
    obeyed: int


class PlaybackCommand(_Wire):
    """What the page asks of a replay; what is left out stays as it is. `halt` stops it where it is, on its way to a place too."""

    halt: Literal[True] | None = None
    playing: bool | None = None
    speed: Annotated[float, Field(gt=0, allow_inf_nan=False)] | Literal["max"] | None = None
    seek_s: FiniteFloat | None = None


@dataclass(slots=True)
class FleetFrame:
    """The fleet at one instant; sent each 0.4 s at most (0.2 s in a replay), only the latest. `playback` is of a replay alone."""

    at_s: float
    utc_minus_service_s: float | None
    estimator: str
    origin: tuple[float, float, float] | None
    vehicles: tuple[VehicleFrame, ...]
    ranges: tuple[RangeSnapshot, ...]
    playback: PlaybackState | None
    kind: Literal["fleet"] = "fleet"


fleet_json = TypeAdapter(FleetFrame).dump_json
"""A `FleetFrame` as JSON: of values that are ours nothing is checked at every picture."""


class CountsFrame(_Wire):
    """What is counted, sent once a second: the links, the ground tools, what was refused, what became of measurements."""

    kind: Literal["counts"] = "counts"
    links: tuple[LinkFrame, ...]
    outs: tuple[OutFrame, ...]
    refused: dict[str, int]
    estimator_counts: dict[str, int]


class Event(_Wire):
    """Something that happened. An `alarm` stays on the page until it is acknowledged there."""

    id: int
    at_s: float
    sysid: int | None
    level: Literal["info", "warning", "error"]
    text: str
    alarm: bool


class EventsFrame(_Wire):
    """Events in their order, each sent once; `missed` were pushed out of the service's memory before they could be sent."""

    kind: Literal["events"] = "events"
    events: tuple[Event, ...]
    missed: int


class VehicleHistory(_Wire):
    """One vehicle's last minutes, column by column, about one sample a second; None where a value was unknown."""

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
    """The tiles that there are under the map: their zooms in the usual scheme, and whose they are."""

    min_zoom: int
    max_zoom: int
    attribution: str


class Hello(_Wire):
    """The first message: which run of the service this is, whether it takes commands or is a replay, and the last minutes."""

    kind: Literal["hello"] = "hello"
    instance: str
    version: str
    commands: bool
    replay: bool
    tiles: TilesInfo | None
    utc_minus_service_s: float | None
    history: tuple[VehicleHistory, ...]
