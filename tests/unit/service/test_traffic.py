"""What is sent to a vehicle that shares its address: nothing that another one there would take as its own."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest

from gcs_coloc.config.settings import Settings
from gcs_coloc.core.aiding.methods.gps_input import no_fix
from gcs_coloc.core.messages.outbound import (
    ExternalPosition,
    GlobalPositionSensor,
    ParameterRequest,
    TimeSyncRequest,
    ToVehicle,
    VisionPosition,
)
from gcs_coloc.links.routes import RouteTable
from gcs_coloc.links.signed_links import SignedLinks
from gcs_coloc.service.traffic import Sender

HERE, THERE = ("127.0.0.1", 5000), ("127.0.0.1", 5001)


@dataclass
class FakeLink:
    name: str = "udp"
    sent: list[tuple[object, bytes]] = field(default_factory=list)

    def __hash__(self) -> int:
        return id(self)

    def send(self, address: object, payload: bytes) -> None:
        self.sent.append((address, payload))


OUTPUTS: list[tuple[ToVehicle, bool]] = [
    (no_fix(4, 1), False),
    (GlobalPositionSensor(4, 1, 47.0, 8.0, 500.0, 1.0, 2.0), False),
    (VisionPosition(4, 1, 1.0, 2.0, 3.0, (1.0, 1.0, 4.0)), False),
    (TimeSyncRequest(4, 1), False),
    (ExternalPosition(4, 1.0, 47.0, 8.0, 5.0), True),
    (ParameterRequest(4, "GPS_PRIMARY"), True),
]


@pytest.mark.parametrize(("output", "is_heeded_by_its_target_alone"), OUTPUTS, ids=lambda value: type(value).__name__)
@pytest.mark.parametrize("is_shared", [False, True])
def test_behind_a_router_only_what_its_target_alone_heeds_is_sent(output, is_heeded_by_its_target_alone, is_shared):
    link, routes = FakeLink(), RouteTable()
    for sysid, address in ((4, HERE), (3, HERE if is_shared else THERE)):
        routes.learn(sysid, 1, link, address, is_autopilot_heartbeat=True, now_s=1.0)
    sender = Sender(
        routes, SignedLinks(Settings().signing, ()), lambda: 2.0, own=(254, 191), sent=lambda _: None, echo=lambda _: None
    )
    sender.send(output)
    assert [address for address, _ in link.sent] == ([HERE] if is_heeded_by_its_target_alone or not is_shared else [])
