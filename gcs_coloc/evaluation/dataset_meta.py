"""The meta data of a data set: `meta.toml`.

It has the nodes, their antennas and what is known of their ranging devices.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from gcs_coloc.core.geodesy import LocalFrame
from gcs_coloc.core.measurements import Vector3, VehicleClass
from gcs_coloc.core.stations.node_id import MAX_STATION_ID, station_node
from gcs_coloc.core.stations.stations import STATION_SIGMA_M
from gcs_coloc.runtime.checked_tables import Number, Table, checked, read_toml

FARTHEST_M = 2e7
"""Half way round the Earth: grids count from afar, but no further."""
_MOST_SCALE = 0.5  # chosen: a half or a double is a wrong unit


@dataclass(frozen=True, slots=True)
class Node:
    """One radio of the data set; `vehicle` is its number for the estimator.

    An anchor has a place (ENU, m) with a sigma (m).

    `antennas`: lever arms (forward, right, down, m) by the antenna's id. `range_bias_m` and `range_scale` are the calibration of
    its device: a range of two nodes is (1 + both scales) times the distance plus both biases. `vehicle_class`: how it moves, None
    where that is not stated.
    """

    id: str
    vehicle: int
    role: str
    place_enu_m: Vector3 | None = None
    sigma_m: float | None = None
    antennas: Mapping[str, Vector3] = field(default_factory=dict)
    range_bias_m: float = 0.0
    range_scale: float = 0.0
    vehicle_class: VehicleClass | None = None


def _excess(scale: float) -> float:
    if abs(scale) >= _MOST_SCALE:
        raise ValueError(f"is the excess over 1, below {_MOST_SCALE}: 0.01 is one per cent")
    return scale


def _differ(ids: Sequence[str], what: str) -> None:
    for each in ids:
        if ids.count(each) > 1:
            raise ValueError(f"two {what} have the id {each!r}")


_Text = Annotated[str, Field(min_length=1)]
_Metres = Annotated[Number, Field(ge=-FARTHEST_M, le=FARTHEST_M)]
_Sigma = Annotated[Number, Field(gt=0.0, le=FARTHEST_M)]


class _Origin(Table):
    lat_deg: Annotated[Number, Field(ge=-90.0, le=90.0)]
    lon_deg: Annotated[Number, Field(ge=-180.0, le=180.0)]
    alt_m: _Metres


class _Device(Table):
    range_bias_m: _Metres = 0.0
    range_scale: Annotated[Number, AfterValidator(_excess)] = 0.0


class _Antenna(Table):
    id: _Text
    forward_m: _Metres
    right_m: _Metres
    down_m: _Metres


class _Node(_Device):
    id: _Text
    antenna: tuple[_Antenna, ...] = ()

    @model_validator(mode="after")
    def _antennas_differ(self) -> Self:
        _differ([antenna.id for antenna in self.antenna], "antennas")
        return self


class _Vehicle(_Node):
    role: Literal["denied", "peer", "subject"]  # subject: denied, in data sets written for version 0.1
    vehicle_class: VehicleClass | None = None


class _Anchor(_Node):
    role: Literal["anchor"]
    e_m: _Metres
    n_m: _Metres
    u_m: _Metres
    sigma_m: _Sigma


class _Station(_Device, _Origin):
    """A fixed station, with the keys of the configuration's `[[station]]`."""

    id: Annotated[int, Field(strict=True, ge=0, le=MAX_STATION_ID)]
    name: str = ""
    sigma_m: _Sigma = STATION_SIGMA_M


class Meta(Table):
    """The content of meta.toml."""

    name: _Text
    source: _Text
    licence: _Text
    dims: Literal[2, 3]
    vehicle_class: VehicleClass | None = None
    origin: _Origin | None = None
    node: Annotated[tuple[Annotated[_Vehicle | _Anchor, Field(discriminator="role")], ...], Field(min_length=1)]
    station: tuple[_Station, ...] = ()

    @model_validator(mode="after")
    def _can_be_located(self) -> Self:
        if self.station and self.origin is None:
            raise ValueError("[[station]] needs [origin]: its position is in degrees, all others are in metres")
        _differ([node.id for node in self.nodes()], "nodes")
        if not any(node.role == "denied" for node in self.nodes()):
            raise ValueError('no node has the role "denied": there is nothing to locate')
        return self

    def place(self) -> Vector3 | None:
        """Return the origin: degrees, and metres above mean sea level."""
        return (self.origin.lat_deg, self.origin.lon_deg, self.origin.alt_m) if self.origin is not None else None

    def nodes(self) -> tuple[Node, ...]:
        """Return the nodes, then the fixed stations.

        A station is an anchor with the id that ranges name it by, STN3 for station 3.
        """
        nodes = [self._node(number, each) for number, each in enumerate(self.node, start=1)]
        if (origin := self.place()) is not None:
            frame = LocalFrame(*origin)
            for each in self.station:
                place = frame.enu_from_geodetic(each.lat_deg, each.lon_deg, each.alt_m)
                device = (each.range_bias_m, each.range_scale)
                nodes.append(Node(f"STN{each.id}", station_node(each.id), "anchor", place, each.sigma_m, {}, *device))
        return tuple(nodes)

    def _node(self, number: int, node: _Vehicle | _Anchor) -> Node:
        antennas: dict[str, Vector3] = {each.id: (each.forward_m, each.right_m, each.down_m) for each in node.antenna}
        device = (antennas, node.range_bias_m, node.range_scale)
        if isinstance(node, _Anchor):
            return Node(node.id, number, node.role, (node.e_m, node.n_m, node.u_m), node.sigma_m, *device)
        role = "denied" if node.role == "subject" else node.role
        return Node(node.id, number, role, None, None, *device, node.vehicle_class or self.vehicle_class)


def read_meta(path: Path) -> Meta:
    """Read meta.toml.

    Raises:
        DataError: it cannot be read, or something in it is wrong; the text names the place.
    """
    return checked(Meta, read_toml(path), str(path))
