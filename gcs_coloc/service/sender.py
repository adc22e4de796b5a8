"""From the engine's outputs to the vehicles: route, signature, encoding, link; each sent frame is recorded."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from gcs_coloc.core.messages.outbound import GpsInput, ToVehicle
from gcs_coloc.links.base import Clock, Route
from gcs_coloc.links.routes import Blocked, RouteTable
from gcs_coloc.links.signed_links import SignedLinks
from gcs_coloc.mavlink.encoder import Encoder
from gcs_coloc.mavlink.refusals import Counts, Refusal
from gcs_coloc.mavlink.signing import Stamp


class Sender:
    """Sends to one fleet's vehicles. `own` is our system and component id.

    `sent` is called with every frame that was sent, `echo` with every GPS_INPUT that was sent.
    """

    def __init__(
        self,
        routes: RouteTable,
        signed: SignedLinks,
        clock: Clock,
        *,
        own: tuple[int, int],
        sent: Callable[[bytes], None],
        echo: Callable[[bytes], None],
    ) -> None:
        self.counts = Counts()
        self._routes = routes
        self._signed = signed
        self._clock = clock
        self._encoder = Encoder(sysid=own[0], compid=own[1])
        self._sent = sent
        self._echo = echo

    def send(self, output: ToVehicle) -> None:
        """Send one output to its vehicle; to one that cannot be reached nothing is sent."""
        # Looked up for every message: an address that came to be shared a moment ago must get nothing.
        route = self._routes.route(output.sysid, self._clock())
        if isinstance(route, Blocked):
            return
        try:
            payload = self._encoder.encode(output, route, self._stamp(route))
        except ValueError:
            self.counts.add(Refusal.NOT_ENCODABLE)
            return
        self._transmit(payload, route)
        if isinstance(output, GpsInput):
            self._echo(payload)

    def send_heartbeat(self, routes: Iterable[Route]) -> None:
        """Send our own heartbeat to each of `routes`."""
        for route in routes:
            self._transmit(self._encoder.heartbeat(route, self._stamp(route)), route)

    def _transmit(self, payload: bytes, route: Route) -> None:
        route.link.send(route.address, payload)
        self._sent(payload)

    def _stamp(self, route: Route) -> Stamp | None:
        signing = self._signed.of(route.link.name)
        return signing.stamp(self._clock()) if signing is not None else None
