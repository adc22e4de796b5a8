"""The link between the two services of a hot standby: authenticated signs of life.

A datagram is the HMAC-SHA256 (RFC 2104) of what follows it, and that is JSON. Without a key the HMAC is a checksum: it is allowed
on loopback alone. A datagram that was recorded and played back is known by its run and number (`SignOfLife`).
"""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import json
from collections.abc import Callable
from enum import StrEnum
from typing import Any

from gcs_coloc.core.errors import LinkError
from gcs_coloc.core.messages.control import OVERRIDE_KINDS, SwitchedReceiver
from gcs_coloc.core.standby.sign_of_life import Identity, OverrideInForce, Shared, SignOfLife, StandbyState, Wish
from gcs_coloc.links.base import Address, Clock, Link
from gcs_coloc.links.transport import reason
from gcs_coloc.links.udp import UdpIn
from gcs_coloc.mavlink.refusals import Counts

FORMAT = 1
"""Of the JSON; both services must have the same."""
_DIGEST_BYTES = hashlib.sha256().digest_size
_MAX_BYTES = 32_768
"""Chosen: overrides of 250 vehicles, three each, take 20 kB."""
_KINDS = {kind: name for name, kind in OVERRIDE_KINDS.items()}


class StandbyRefusal(StrEnum):
    """Why a datagram on the link of a hot standby was refused.

    Its value is the `reason` label of the metric.
    """

    WRONG_KEY = "standby_wrong_key"
    """It was not made with our key, or was damaged."""
    OTHER_FORMAT = "standby_other_format"
    """The other service is of a version that tells something else."""


class StandbyLink:
    """Sends signs of life to the other service and receives its own.

    `peer` is where the other service listens, `listen` where this one does: host and port.
    """

    def __init__(
        self,
        peer: tuple[str, int],
        listen: tuple[str, int],
        key: bytes,
        clock: Clock,
        received: Callable[[SignOfLife], None],
    ) -> None:
        self.counts = Counts()
        self._peer = peer
        self._peer_address: Address | None = None
        self._key = key
        self._received = received
        self._link = UdpIn(*listen).make_link(self._on_datagram, clock)

    @property
    def refusals(self) -> list[Counts]:
        """What was refused or lost here, by reason."""
        return [self.counts, self._link.counts]

    async def open(self) -> None:
        """Bind, and look up the other service. LinkError where either fails."""
        await self._link.open()
        host, port = self._peer
        try:
            found = await asyncio.get_running_loop().getaddrinfo(host, port, type=2)
        except OSError as error:
            raise LinkError(f"standby.peer: host {host!r} is not found ({reason(error)})") from error
        listens_on_ipv6 = ":" in str(self._link.name).removeprefix("udpin:").rpartition(":")[0]
        self._peer_address = min(found, key=lambda entry: (len(entry[4]) == 4) != listens_on_ipv6)[4]

    def send(self, sign: SignOfLife) -> None:
        """Send one sign of life; one that the system does not accept is counted."""
        if self._peer_address is not None:
            self._link.send(self._peer_address, pack(sign, self._key))

    async def close(self) -> None:
        """Close the socket."""
        await self._link.close()

    def _on_datagram(self, link: Link, address: Address, payload: bytes, received_at_s: float) -> None:
        del link, address, received_at_s
        sign = unpack(payload, self._key)
        if isinstance(sign, StandbyRefusal):
            self.counts.add(sign)
        else:
            self._received(sign)


def pack(sign: SignOfLife, key: bytes) -> bytes:
    """A sign of life as a datagram."""
    content = {
        "v": FORMAT,
        "from": sign.sender,
        "run": sign.run,
        "number": sign.number,
        "heard": [sign.heard_run, sign.heard_number],
        "state": sign.state,
        "term": sign.term,
        "wish": sign.wish,
        "feeding": sign.shared.feeding,
        "overrides": [[sysid, _KINDS[type(override)], override.value] for sysid, override in sign.shared.overrides],
        "switched": sign.shared.switched,
    }
    body = json.dumps(content, separators=(",", ":")).encode()
    return hmac.digest(key, body, "sha256") + body


def unpack(datagram: bytes, key: bytes) -> SignOfLife | StandbyRefusal:
    """The sign of life in a datagram, or why there is none. Nothing is parsed before the key is proven."""
    digest, body = datagram[:_DIGEST_BYTES], datagram[_DIGEST_BYTES:]
    if len(datagram) > _MAX_BYTES or not hmac.compare_digest(hmac.digest(key, body, "sha256"), digest):
        return StandbyRefusal.WRONG_KEY
    try:
        content = json.loads(body)
        return _sign(content) if content["v"] == FORMAT else StandbyRefusal.OTHER_FORMAT
    except (ValueError, KeyError, TypeError):
        return StandbyRefusal.OTHER_FORMAT


def _sign(content: dict[str, Any]) -> SignOfLife:
    sysid, compid = content["from"]
    heard_run, heard_number = content["heard"]
    shared = Shared(
        tuple(int(each) for each in content["feeding"]),
        tuple(OverrideInForce(int(of), OVERRIDE_KINDS[kind](value)) for of, kind, value in content["overrides"]),
        tuple(
            SwitchedReceiver(int(of), float(before) if before is not None else None, int(kind) if kind is not None else None)
            for of, before, kind in content["switched"]
        ),
    )
    return SignOfLife(
        Identity(int(sysid), int(compid)),
        int(content["run"]),
        int(content["number"]),
        int(heard_run),
        int(heard_number),
        StandbyState(content["state"]),
        int(content["term"]),
        Wish(content["wish"]),
        shared,
    )
