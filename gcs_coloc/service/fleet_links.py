"""The links of one fleet, with the parts that work on them.

These are routes, signatures, receiver, sender, and the forwarder to the ground tools.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass

from gcs_coloc.config.settings import Settings
from gcs_coloc.links.base import Address, Link, Route, check_outs, parse
from gcs_coloc.links.forward import Forwarder
from gcs_coloc.links.routes import RouteTable
from gcs_coloc.links.signed_links import SignedLinks
from gcs_coloc.mavlink.framing import RawFrame
from gcs_coloc.mavlink.refusals import Counts
from gcs_coloc.runtime.clock import ServiceClock
from gcs_coloc.service.traffic import Receiver, Sender

log = logging.getLogger("gcs_coloc")

_MOST_WAITING = 1024
"""Datagrams of one link that are received at once. Chosen: what 1 MB of the system's buffer holds of MAVLink frames."""


@dataclass(frozen=True, slots=True)
class LinkHooks:
    """What the links call as they receive and send."""

    on_datagram: Callable[[Link, Address, bytes, float], None]
    """Takes what a link has received, and when, in service time."""
    on_sent: Callable[[bytes], None]
    """Takes each frame that was sent to a vehicle."""
    on_forwarded: Callable[[RawFrame], None]
    """Takes each frame that a ground tool has sent to a vehicle."""
    on_foreign_gps_input: Callable[[RawFrame, int], None]
    """Takes a GPS_INPUT that a ground tool has sent, and the vehicle's system id."""
    is_aided: Callable[[int], bool]
    """Says whether a vehicle is aided by this service: nobody else may then send it positions."""
    may_send: Callable[[int], bool]
    """Says whether a vehicle may be sent now what changes what it does."""
    is_other_service: Callable[[int, int], bool] | None
    """Says whether a sender is the other service of a hot standby; None without one."""


class FleetLinks:
    """All links of one fleet. None is open before `open`."""

    def __init__(self, settings: Settings, clock: ServiceClock, utc_minus_service_s: float | None, hooks: LinkHooks) -> None:
        """Build the links and all parts that work on them.

        `utc_minus_service_s`: the host's UTC minus service time, s; None where the host does not know UTC.
        """
        own, senders = settings.mavlink.own, settings.senders
        check_outs(settings.out, settings.links)
        self._routes = RouteTable(rebind_after_s=senders.rebind_after_s, companions_elsewhere=senders.companions_elsewhere)
        self.signed = SignedLinks(settings.signing, settings.links, settings.out)
        self.signed.set_clock(utc_minus_service_s)  # before the first frame: a recorded frame is known by its old time
        self.receiver = Receiver(
            self._routes, self.signed, own=own, bytes_per_s=senders.bytes_per_s, is_other_service=hooks.is_other_service
        )
        self.forwarder = Forwarder(
            settings.out,
            self._routes,
            self.signed,
            clock,
            own=own,
            bytes_per_s=senders.bytes_per_s,
            is_aided=hooks.is_aided,
            forwarded=hooks.on_forwarded,
            foreign_gps_input=hooks.on_foreign_gps_input,
        )
        self.sender = Sender(
            self._routes,
            self.signed,
            clock,
            own=own,
            sent=hooks.on_sent,
            echo=self.forwarder.echo if settings.forward.echo_gps_input else lambda _: None,
            may_send=hooks.may_send,
        )
        addresses = [parse(text) for text in settings.links]
        self._links = [address.make_link(hooks.on_datagram, clock) for address in addresses]
        self._openings = [address.opening for address in addresses]

    @property
    def refusals(self) -> list[Counts]:
        """What is refused at the links, each place with counts of its own."""
        at_links = (link.counts for link in self._links)
        return [*self.receiver.refusals, self._routes.counts, self.sender.counts, *at_links, *self.forwarder.refusals]

    async def open(self) -> None:
        """Open the ground tools' links, then the vehicles', one after the other.

        LinkError where one cannot be opened.
        """
        await self.forwarder.open()  # first, so that what is received can be forwarded
        for link, opening in zip(self._links, self._openings, strict=True):
            await link.open()
            log.info("%s", opening)

    async def close(self) -> None:
        """Close the vehicles' links, then the ground tools'."""
        for link in self._links:
            await link.close()
        await self.forwarder.close()

    def receive_waiting(self) -> None:
        """Read what waits at all links."""
        for link in self._links:
            link.receive_waiting(_MOST_WAITING)

    def send_heartbeat(self, sysids: Collection[int], now_s: float) -> None:
        """Send our heartbeat to every vehicle, and to every peer that may wait for our first frame."""
        routes = (self._routes.route(sysid, now_s) for sysid in sysids)
        greeted = {route for route in routes if isinstance(route, Route)}
        # A vehicle or router may wait for our first frame before it sends any, hence the links' peers.
        greeted |= {Route(link, peer) for link in self._links for peer in link.peers}
        # A sender that signs with the key, but behind our time, is refused until it has heard a frame of ours.
        self.sender.send_heartbeat(
            greeted | {Route(*source) for source in self.receiver.pop_behind() if isinstance(source, tuple)}
        )

    def pending_warnings(self, now_s: float) -> Iterator[tuple[int | None, str]]:
        """Yield the pending warnings of signatures, routes and ground tools.

        Each has the system id of the vehicle that it concerns; None where it concerns none.
        """
        ahead = self.signed.pending_warning(now_s)
        if ahead is not None:
            yield None, ahead
        yield from self._routes.conflicts.pending_warnings(now_s)
        yield from self.forwarder.pending_warnings(now_s)
