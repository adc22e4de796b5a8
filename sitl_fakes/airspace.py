"""Aircraft of one scenario in several processes: each sends the true states of its aircraft by multicast.

What a ranging device measures depends on the truth at both ends, and an aircraft that flies on GPS_INPUT is nowhere to be
computed but in its own process.
"""

from __future__ import annotations

import asyncio
import json
import logging
import secrets
import socket
from collections.abc import Callable, Collection, Iterable
from dataclasses import asdict

from sitl_fakes.errors import SocketError
from sitl_fakes.truth import SharedState

_log = logging.getLogger(__name__)

_MOST_WARNINGS = 20


class Airspace:
    """The multicast group that the processes of one scenario share, on the network that leads to `target`.

    `on_state` is called with the states of aircraft other than `ours`, with UNIX times as on the wire. Raises
    `SocketError` where the group cannot be joined.
    """

    def __init__(
        self,
        group: tuple[str, int],
        target: tuple[str, int],
        scenario: str,
        ours: Collection[int],
        on_state: Callable[[SharedState], None],
    ) -> None:
        self._group = group
        self._scenario = scenario
        self._ours = frozenset(ours)
        self._on_state = on_state
        self._process = secrets.token_hex(8)
        self._warned: set[str] = set()
        try:
            self._socket = _join(group, target)
        except OSError as error:
            raise SocketError(f"cannot join the multicast group {group[0]}:{group[1]}: {error.strerror or error}") from error
        asyncio.get_running_loop().add_reader(self._socket, self._read)

    def send(self, aircraft: Iterable[SharedState]) -> None:
        """Send the states of our aircraft, at UNIX times. A datagram that the network refuses is lost; newer ones follow."""
        for one in aircraft:
            text = json.dumps({"process": self._process, "scenario": self._scenario, **asdict(one)})
            try:
                self._socket.sendto(text.encode(), self._group)
            except OSError as error:
                _log.debug("not sent: %s", error)

    def close(self) -> None:
        """Leave the group."""
        asyncio.get_running_loop().remove_reader(self._socket)
        self._socket.close()

    def _read(self) -> None:
        payload, sender = self._socket.recvfrom(2048)
        try:
            fields = json.loads(payload)
            process, scenario = fields.pop("process"), fields.pop("scenario")
            state = SharedState.from_json(fields)
        except (ValueError, TypeError, KeyError, AttributeError):
            self._warn_once(f"{sender[0]} speaks in the airspace, but not of simulated aircraft")
            return
        if process == self._process:
            return
        if scenario != self._scenario:
            self._warn_once(f"{sender[0]} flies another scenario, {scenario!r}, in the same airspace: it is not seen")
        elif state.sysid in self._ours:
            self._warn_once(f"vehicle {state.sysid} is flown by {sender[0]} as well")
        else:
            self._on_state(state)

    def _warn_once(self, text: str) -> None:
        if text not in self._warned and len(self._warned) < _MOST_WARNINGS:
            self._warned.add(text)
            _log.warning("%s", text)


def _join(group: tuple[str, int], target: tuple[str, int]) -> socket.socket:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect(target[:2])
        interface = socket.inet_aton(probe.getsockname()[0])
    joined = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        joined.setblocking(False)
        joined.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # several processes of one machine share the port
        joined.bind(group)
        joined.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(group[0]) + interface)
        joined.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, interface)
    except OSError:
        joined.close()
        raise
    return joined
