"""Forwards raw frames between the vehicles and ground tools such as QGroundControl, both ways.

No frame of a ground tool gets to the engine or into the table of routes: a tool can neither become a vehicle nor take the
place of one.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from gcs_coloc.core.alarms.status_texts import StatusText
from gcs_coloc.core.snapshot import OutSnapshot
from gcs_coloc.links.base import Address, Clock, Link, Route, parse_out
from gcs_coloc.links.rate_limiter import RateLimiter
from gcs_coloc.links.routes import RouteTable
from gcs_coloc.links.signed_links import SignedLinks
from gcs_coloc.mavlink.decoder import INVALID_SYSID
from gcs_coloc.mavlink.encoder import Encoder
from gcs_coloc.mavlink.framing import EVERYBODY, RawFrame, split, target_of
from gcs_coloc.mavlink.refusals import Counts, Reason, Refusal

MAX_TOOLS = 16
"""Ground tools of one listening UDP port. Chosen: more than people at a ground station use."""
TOOL_KEPT_S = 30.0
"""A ground tool that was silent for so long has gone. Chosen: they all send a heartbeat every second."""
MAX_UNSENT_BYTES = 65_536
"""Frames that wait for a slow ground tool. Chosen: more than a burst of all parameters, some 40,000 bytes."""
WARN_EVERY_S = 10.0
"""Chosen: a tool may send positions many times a second, and a person can use one line in this time."""

_AIDING_MESSAGES = {
    mavlink.MAVLINK_MSG_ID_GPS_INPUT: "GPS_INPUT",
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_SENSOR: "GLOBAL_POSITION_SENSOR",
    mavlink.MAVLINK_MSG_ID_VISION_POSITION_ESTIMATE: "VISION_POSITION_ESTIMATE",
}
"""Messages by which vehicles are sent positions at a rate, by id."""
_DROPPED = (Refusal.OUTPUT_SKIPPED, Refusal.NOT_CONNECTED, Refusal.NOT_SENT)
"""Reasons why a frame did not go to a ground tool."""

log = logging.getLogger("gcs_coloc")


@dataclass(slots=True)
class _Out:
    """One connection string's ground tools.

    `tools`: the addresses heard on a listening UDP port, and when.
    """

    link: Link
    listens: bool
    tools: dict[Address, float] = field(default_factory=dict)
    frames_sent: int = 0
    frames_accepted: int = 0
    refused: int = 0

    def peers(self, now_s: float) -> tuple[Address, ...]:
        if not self.listens:
            return self.link.peers
        for address in [address for address, heard_at_s in self.tools.items() if now_s - heard_at_s > TOOL_KEPT_S]:
            del self.tools[address]
        return tuple(self.tools)


class Forwarder:
    """Forwards frames between vehicles and ground tools, both ways.

    Every call returns at once: a slow or absent ground tool loses its own oldest frames.
    `routes`, `signed`: the fleet's. `is_aided` is whether we send positions to a vehicle; `forwarded` is called with every
    frame that was sent on to a vehicle, `foreign_gps_input` with a ground tool's GPS_INPUT and each vehicle it was sent to.
    """

    def __init__(
        self,
        outs: Sequence[str],
        routes: RouteTable,
        signed: SignedLinks,
        clock: Clock,
        *,
        own: tuple[int, int],
        bytes_per_s: float,
        is_aided: Callable[[int], bool],
        forwarded: Callable[[RawFrame], None],
        foreign_gps_input: Callable[[RawFrame, int], None],
    ) -> None:
        self.counts = Counts()
        self._routes = routes
        self._signed = signed
        self._clock = clock
        self._own = own
        self._is_aided = is_aided
        self._forwarded = forwarded
        self._foreign_gps_input = foreign_gps_input
        self._rate_limiter = RateLimiter(bytes_per_s)
        self._outs: dict[Link, _Out] = {}
        for address in (parse_out(text) for text in outs):
            link = address.make_link(self.from_ground_tool, clock, most_unsent_bytes=MAX_UNSENT_BYTES)
            self._outs[link] = _Out(link, listens=address.LEARNS_PEERS)
        self._encoders: dict[int, Encoder] = {}
        self._suppressed: dict[int, tuple[str, str]] = {}
        self._warned_at_s = float("-inf")

    @property
    def links(self) -> tuple[Link, ...]:
        """The ground tools' links, in the order of their connection strings."""
        return tuple(self._outs)

    @property
    def refusals(self) -> list[Counts]:
        """What was refused or lost here, by reason."""
        return [self.counts, self._rate_limiter.counts, *(link.counts for link in self._outs)]

    async def open(self) -> None:
        """Open the ground tools' links. LinkError where one cannot be opened."""
        for link in self._outs:
            await link.open()
            log.info("forwarding to %s", link.name)

    async def close(self) -> None:
        """Close them."""
        for link in self._outs:
            await link.close()

    def from_vehicle(self, frames: Iterable[RawFrame], link: Link, address: Address, now_s: float) -> None:
        """Forward the valid frames of one datagram from a vehicle's address."""
        if not self._outs:
            return
        good = []
        for raw in frames:
            if self._routes.comes_from_its_binding(raw.sysid, raw.compid, link, address, now_s):
                good.append(raw.frame)
            else:
                self.counts.add(Refusal.FORWARD_ADDRESS_CONFLICT)
        if good:
            self._to_ground(b"".join(good), len(good), now_s)

    def from_ground_tool(self, link: Link, address: Address, payload: bytes, received_at_s: float) -> None:
        """Send the valid frames in a ground tool's payload to the vehicles that they address.

        `payload` is one datagram, or one whole frame of a stream.
        """
        out = self._outs[link]
        if not self._rate_limiter.admits((link, address), len(payload), received_at_s):
            out.refused += 1
            return
        if not self._admits_sender(out, address, received_at_s):
            return
        signing, damage = self._signed.of(link.name), Counts()
        for raw in split(payload, damage, ended=True)[0]:
            refusal: Reason | None = signing.refusal(raw, received_at_s) if signing is not None else None
            if refusal is None:
                refusal = self._refusal(raw)
            if refusal is not None:
                self._refuse(out, refusal)
            else:
                out.frames_accepted += 1
                self._to_vehicles(raw, out)
        self.counts.update(damage)
        out.refused += bool(damage)

    def echo(self, frame: bytes) -> None:
        """Send the ground tools a frame of our own."""
        self._to_ground(frame, 1, self._clock())

    def send_status(self, texts: Sequence[StatusText], sysids: Sequence[int]) -> None:
        """Send the ground tools our heartbeat and status texts.

        A text has its vehicle's system id and our component id: tools show those of the system that they look at.
        `sysids` are the vehicles. A text without a system id is about the fleet and is sent once for each of them.
        Nothing is sent before a vehicle is heard: Mission Planner connects to what it hears first, and alone.
        """
        if not sysids:
            return
        now_s = self._clock()
        for out in self._outs.values():
            peers = out.peers(now_s)
            if not peers:
                continue
            signing = self._signed.of(out.link.name)
            addressed = [(text, sysid) for text in texts for sysid in (sysids if text.sysid is None else (text.sysid,))]
            frames = [self._encoder(self._own[0]).heartbeat(out.link.name, signing.stamp(now_s) if signing is not None else None)]
            for text, sysid in addressed:
                stamp = partial(signing.stamp, now_s) if signing is not None else None
                frames += self._encoder(sysid).status_text(text.severity, text.text, out.link.name, stamp)
            for peer in peers:
                for frame in frames:
                    out.link.send(peer, frame)
            out.frames_sent += len(frames) * len(peers)

    def pending_warnings(self, now_s: float) -> list[tuple[int, str]]:
        """System id and text of the warnings that are due."""
        if not self._suppressed or now_s - self._warned_at_s < WARN_EVERY_S:
            return []
        self._warned_at_s = now_s
        suppressed, self._suppressed = self._suppressed, {}
        text = "as well: it is kept from this vehicle, which is being aided by us. Stop one of the two"
        return [(sysid, f"a ground tool on {name} sends {what} {text}") for sysid, (name, what) in sorted(suppressed.items())]

    def snapshots(self) -> tuple[OutSnapshot, ...]:
        """The ground tools of each connection string, and their frames since the start."""
        now_s = self._clock()
        return tuple(
            OutSnapshot(
                name=out.link.name,
                tools=len(out.peers(now_s)),
                frames_sent=out.frames_sent,
                frames_accepted=out.frames_accepted,
                dropped=sum(out.link.counts[reason] for reason in _DROPPED),
                refused=out.refused,
            )
            for out in self._outs.values()
        )

    def _encoder(self, sysid: int) -> Encoder:
        """The encoder of the frames that our component sends in a system's name; each numbers its own."""
        return self._encoders.setdefault(sysid, Encoder(sysid=sysid, compid=self._own[1]))

    def _to_ground(self, payload: bytes, frames: int, now_s: float) -> None:
        for out in self._outs.values():
            for peer in out.peers(now_s):
                out.link.send(peer, payload)
                out.frames_sent += frames

    def _refuse(self, out: _Out, reason: Reason) -> None:
        self.counts.add(reason)
        out.refused += 1

    def _refusal(self, raw: RawFrame) -> Reason | None:
        if (raw.sysid, raw.compid) == self._own:
            return Refusal.ECHO
        if raw.sysid == 0:
            return INVALID_SYSID
        return Refusal.GROUND_TOOL_USES_VEHICLE_ID if self._routes.is_vehicle(raw.sysid) else None

    def _admits_sender(self, out: _Out, address: Address, now_s: float) -> bool:
        """Whether a datagram comes from one of this link's ground tools.

        A new sender to a listening port becomes one.
        """
        if not out.listens:
            # A port that we only send from is open to the network as well.
            if address not in out.link.peers:
                self._refuse(out, Refusal.UNKNOWN_GROUND_TOOL)
                return False
            return True
        if address not in out.tools and len(out.peers(now_s)) >= MAX_TOOLS:
            self._refuse(out, Refusal.TOO_MANY_GROUND_TOOLS)
            return False
        out.tools[address] = now_s
        return True

    def _to_vehicles(self, raw: RawFrame, out: _Out) -> None:
        sysid, compid = target = target_of(raw)
        routes: Iterable[Route]
        if target == EVERYBODY or sysid == 0:
            routes = self._routes.vehicles()
        elif sysid == self._own[0] and compid in (0, self._own[1]):
            return  # addressed to us, and we accept no commands over MAVLink
        else:
            routes = self._routes.reach(sysid, compid)
            if not routes:
                self._refuse(out, Refusal.GROUND_TOOL_UNKNOWN_TARGET)
        if raw.message_id in _AIDING_MESSAGES:
            routes = self._unaided(raw, routes, out)
        sent = False
        for route in routes:
            route.link.send(route.address, raw.frame, forwarded=True)
            sent = True
        if sent:
            self._forwarded(raw)

    def _unaided(self, raw: RawFrame, routes: Iterable[Route], out: _Out) -> list[Route]:
        """Return the routes at which we aid nobody.

        A vehicle that is sent positions by two senders would use both, in turns.
        """
        vehicles, unaided = self._routes.vehicles(), []
        for route in routes:
            sysids = vehicles.get(route, set())
            aided = [sysid for sysid in sysids if self._is_aided(sysid)]
            if aided:
                self._refuse(out, Refusal.GROUND_TOOL_AIDING)
                self._suppressed.update(dict.fromkeys(aided, (out.link.name, _AIDING_MESSAGES[raw.message_id])))
                continue
            unaided.append(route)
            if raw.message_id == mavlink.MAVLINK_MSG_ID_GPS_INPUT:
                for sysid in sorted(sysids):
                    self._foreign_gps_input(raw, sysid)
        return unaided
