"""The traffic between links and engine: datagrams to messages, and outputs to frames."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass, field, replace

from gcs_coloc.core.messages.control import ForeignGpsInput, RouteReport
from gcs_coloc.core.messages.inbound import Inbound
from gcs_coloc.core.messages.outbound import ChangesVehicle, GpsInput, ToVehicle, Untargeted
from gcs_coloc.links.base import Address, Clock, Link, Route
from gcs_coloc.links.rate_limiter import RateLimiter
from gcs_coloc.links.routes import Blocked, RouteTable
from gcs_coloc.links.signed_links import SignedLinks
from gcs_coloc.mavlink.decoder import TRUTH_IDS, Decoder, Frame, HeardTruth, SequenceTracker, truth_of
from gcs_coloc.mavlink.encoder import Encoder
from gcs_coloc.mavlink.framing import RawFrame
from gcs_coloc.mavlink.refusals import Counts, Refusal
from gcs_coloc.mavlink.signing import Stamp


@dataclass(slots=True)
class ReceivedDatagram:
    """What one datagram holds. `messages` are the engine's, in order.

    `link_reports` are those of them that follow from where the datagram came from: no frame of a recording holds them.
    `frames` are all valid frames of others, `refused` the decoded ones that the routes refused. `truths`: where a simulation
    says that vehicles truly are. `fed_by_other`: whom the other service of a hot standby feeds by it.
    """

    # Tuples: most datagrams leave most of these empty, and five new lists cost more than the rest of an unused message.
    messages: tuple[Inbound, ...] = ()
    link_reports: tuple[RouteReport | ForeignGpsInput, ...] = ()
    frames: list[RawFrame] = field(default_factory=list)
    refused: tuple[Frame, ...] = ()
    truths: tuple[HeardTruth, ...] = ()
    fed_by_other: tuple[int, ...] = ()

    def add_report(self, report: RouteReport | ForeignGpsInput) -> None:
        """Append a message that follows from where the datagram came from."""
        self.messages += (report,)
        self.link_reports += (report,)


class Receiver:
    """Receives one fleet's datagrams.

    `own` is our system and component id, `bytes_per_s` what each source may send.
    `is_other_service`: whether a system and component id are those of a hot standby's other service, whose GPS_INPUT is no
    rival's; None without one.
    """

    def __init__(
        self,
        routes: RouteTable,
        signed: SignedLinks,
        *,
        own: tuple[int, int],
        bytes_per_s: float,
        is_other_service: Callable[[int, int], bool] | None = None,
    ) -> None:
        self._routes = routes
        self._signed = signed
        self._rate_limiter = RateLimiter(bytes_per_s)
        self._is_other_service = is_other_service
        self._decoder = Decoder(own_sysid=own[0], own_compid=own[1], has_other_service=is_other_service is not None)

    @property
    def refusals(self) -> list[Counts]:
        """What was refused here, by reason."""
        return [self._decoder.counts, self._rate_limiter.counts]

    @property
    def sequences(self) -> SequenceTracker:
        """The reception of every sender."""
        return self._decoder.sequences

    def pop_behind(self) -> tuple[Hashable, ...]:
        """The sources that sign with our key, but behind our time, since the last call."""
        return self._decoder.pop_behind()

    def admits(self, link: Link, address: Address, size: int, now_s: float) -> bool:
        """Whether a datagram of `size` bytes is within the rate limit of where it came from."""
        return self._rate_limiter.admits((link, address), size, now_s)

    def receive(self, payload: bytes, link: Link, address: Address, now_s: float) -> ReceivedDatagram:
        """Decode an admitted datagram and learn from it where vehicles are.

        `now_s` is the service time at which it arrived.
        """
        received = ReceivedDatagram()
        for frame in self._decoder.decode(payload, now_s, (link, address), self._signed.of(link.name), received.frames):
            if isinstance(frame.message, ForeignGpsInput):
                if self._is_other_service is not None and self._is_other_service(frame.sysid, frame.compid):
                    received.fed_by_other += self._routes.autopilots_at(link, address, now_s)
                    continue
                # Every vehicle at the address it came from uses it, whoever sends it.
                for sysid in self._routes.autopilots_at(link, address, now_s):
                    received.add_report(replace(frame.message, vehicle=sysid))
            if not self._learn_route(frame, link, address, now_s):
                received.refused += (frame,)
            elif frame.message is not None:
                received.messages += (frame.message,)
                if frame.is_autopilot_heartbeat:
                    proven = frame.sysid if self._routes.is_proven(frame.sysid) else None
                    self._rate_limiter.add_source((link, address), now_s, proven)
                    received.add_report(self._route_report(frame.sysid, now_s))
        for raw in received.frames:
            if raw.message_id in TRUTH_IDS:
                truth = truth_of(raw, now_s)
                if truth is not None and self._learn_route(raw, link, address, now_s):
                    received.truths += (truth,)
        return received

    def _learn_route(self, frame: Frame | RawFrame, link: Link, address: Address, now_s: float) -> bool:
        return self._routes.learn(
            frame.sysid,
            frame.compid,
            link,
            address,
            is_autopilot_heartbeat=isinstance(frame, Frame) and frame.is_autopilot_heartbeat,
            is_other_heartbeat=isinstance(frame, Frame) and frame.is_other_heartbeat,
            now_s=now_s,
        )

    def _route_report(self, sysid: int, now_s: float) -> RouteReport:
        route = self._routes.route(sysid, now_s)
        if isinstance(route, Blocked):
            return RouteReport(sysid, now_s, route.reason, route.shared_with)
        return RouteReport(sysid, now_s, None)


class Sender:
    """Sends to one fleet's vehicles. `own` is our system and component id.

    `sent` is called with every frame that was sent, `echo` with every GPS_INPUT that was sent. `may_send` is asked whether a
    vehicle may be sent what changes what it does, right before that is sent.
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
        may_send: Callable[[int], bool] = lambda _: True,
    ) -> None:
        self.counts = Counts()
        self._routes = routes
        self._signed = signed
        self._clock = clock
        self._encoder = Encoder(sysid=own[0], compid=own[1])
        self._sent = sent
        self._echo = echo
        self._may_send = may_send

    def send(self, output: ToVehicle) -> None:
        """Send one output to its vehicle, where that can be reached.

        An output without a target is not sent where other vehicles share the address: they would use it too.
        """
        # Looked up for every message: an address that came to be shared a moment ago must get nothing.
        route = self._routes.route(output.sysid, self._clock())
        if isinstance(route, Blocked):
            if route.route is None or isinstance(output, Untargeted):
                return
            route = route.route
        try:
            payload = self._encoder.encode(output, route, self._stamp(route))
        except ValueError:
            self.counts.add(Refusal.NOT_ENCODABLE)
            return
        if isinstance(output, ChangesVehicle) and not self._may_send(output.sysid):
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
