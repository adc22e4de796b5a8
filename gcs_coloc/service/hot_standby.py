"""Hot standby in the service: connects its state machine with link, engine and operator."""

from __future__ import annotations

import logging
import secrets
from collections.abc import Callable
from pathlib import Path

from gcs_coloc.config.settings import Settings
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages.control import (
    AidingOverride,
    CommandSource,
    GpsOverride,
    HoldBack,
    OperatorCommand,
    Override,
    PrimaryOverride,
    SwitchedByOther,
)
from gcs_coloc.core.messages.inbound import FromVehicle, GpsReceiver
from gcs_coloc.core.messages.outbound import Notice
from gcs_coloc.core.reasons import StatedReason
from gcs_coloc.core.standby.sign_of_life import (
    Identity,
    OverrideInForce,
    SignOfLife,
    StandbyOrder,
    StandbyReason,
    StandbyState,
)
from gcs_coloc.core.standby.standby_peer import TICK_S, StandbyPeer
from gcs_coloc.core.standby.standby_snapshot import StandbySnapshot
from gcs_coloc.links.signed_links import read_key
from gcs_coloc.links.standby_link import StandbyLink
from gcs_coloc.mavlink.refusals import Counts
from gcs_coloc.runtime.clock import ServiceClock, Timer
from gcs_coloc.service.traffic import ReceivedDatagram

log = logging.getLogger("gcs_coloc")

_RUN_BITS = 48
"""Chosen: no start of a service draws the number of another, and JSON numbers hold it everywhere."""
_AUTOMATIC = (GpsOverride.AUTO, AidingOverride.AUTO, PrimaryOverride.AUTO)
_LAST_SIGNS = 3
"""With which a service that ends gives way. Chosen: one gets through, and there is no time to wait for an answer."""
_WORDS = {
    StandbyState.LISTENING: "hot standby: listening whether the other service sends",
    StandbyState.ACTIVE: "hot standby: this service is active, it sends",
    StandbyState.HELD_UP: "hot standby: sending is stopped for a moment",
    StandbyState.STANDBY: "hot standby: this service follows, and takes over if the other one fails",
    StandbyState.PASSIVE: "hot standby: this service follows, and does not take over until it is told",
}
_LEVELS = {StandbyReason.TOOK_OVER: "error", StandbyReason.OTHER_FEEDS: "warning", StandbyReason.STOOD_STILL: "warning"}


class HotStandby:
    """Our own service's part of a hot standby.

    `apply` passes a message to the engine, `publish` a notice to the operator.
    `is_behind`: whether the service is too busy to send what it should. It then gives no sign of life: the other one takes over.

    Raises:
        ConfigError: the key file is of no use.
    """

    def __init__(
        self,
        settings: Settings,
        clock: ServiceClock,
        engine: Engine,
        apply: Callable[[HoldBack | SwitchedByOther | OperatorCommand], None],
        publish: Callable[[Notice], None],
        is_behind: Callable[[], bool],
    ) -> None:
        config, mavlink = settings.standby, settings.mavlink
        self._clock = clock
        self._engine = engine
        self._apply = apply
        self._publish = publish
        self._is_behind = is_behind
        self._gps_id = settings.aiding.gps_id
        self._peer = StandbyPeer(
            Identity(mavlink.system_id, mavlink.component_id),
            secrets.randbits(_RUN_BITS),
            is_active=config.role == "active",
            now_s=clock(),
            period_s=1.0 / settings.aiding.rate_hz,
        )
        key = read_key(Path(config.key_file)) if config.key_file else b""
        self._link = StandbyLink(config.peer_address(), config.listen_address(), key, clock, self._receive)
        self._timer = Timer(clock, self._tick)
        self._told: tuple[StandbyState, StatedReason[StandbyReason]] | None = None
        self.is_held_back = True
        """Whether the engine holds back what changes what vehicles do."""
        self._where = config.peer

    @property
    def refusals(self) -> list[Counts]:
        """What was refused on the link, by reason."""
        return self._link.refusals

    async def open(self) -> None:
        """Open the link. LinkError where that fails."""
        await self._link.open()
        log.info("hot standby: the other service is at %s", self._where)

    def start(self) -> None:
        """Hold back the outputs that change vehicles, and begin to exchange signs of life."""
        self._apply(HoldBack(self._clock(), held=True))
        self._tick()

    def give_way(self) -> None:
        """Let the other service take over, if it stands by.

        Otherwise this service ends as one without a hot standby does.
        """
        self._timer.cancel()
        now_s = self._clock()
        if self._peer.state is not StandbyState.ACTIVE or not self._peer.other_stands_by(now_s):
            return
        if self._peer.order(StandbyOrder.RELEASE, now_s) is None:
            self._synchronise()
            for _ in range(_LAST_SIGNS):
                self._send_sign()

    async def close(self) -> None:
        """Close the link."""
        self._timer.cancel()
        await self._link.close()

    def may_send(self, sysid: int) -> bool:
        """Return whether a vehicle may be sent, now, what changes what it does."""
        return self._peer.may_send(sysid, self._clock())

    def is_other_service(self, sysid: int, compid: int) -> bool:
        """Return whether a sender is the other service, by system and component id.

        True also where it may be, as long as the other service was not heard.
        """
        return self._peer.may_be_other(Identity(sysid, compid))

    def watch(self, received: ReceivedDatagram, at_s: float) -> None:
        """Learn from a datagram which service feeds a vehicle."""
        watch = self._peer.watch
        for message in received.messages:
            if not isinstance(message, FromVehicle):
                continue
            if isinstance(message, GpsReceiver) and message.receiver == self._gps_id:
                watch.add_fed_receiver(message.sysid, at_s, message.fixed_boot_s)
            else:
                watch.add_heard(message.sysid, at_s)
        for sysid in received.fed_by_other:
            watch.add_passed_on(sysid, at_s)

    def tell_after_sending(self) -> None:
        """Send the next sign of life together with what was sent to vehicles, if it is due soon.

        A service that dies is then silent from its last output on.
        """
        if self._peer.state is StandbyState.ACTIVE and self._peer.sign_is_due(self._clock() + TICK_S):
            self._send_sign()

    def order(self, order: StandbyOrder) -> str | None:
        """Carry out an operator's order; return why where that is not done, else None."""
        refusal = self._peer.order(order, self._clock())
        self._publish(Notice(self._clock(), None, "info", f"operator: hot standby: {order.value.replace('_', ' ')}"))
        self._synchronise()
        self._send_due()
        return refusal.text if refusal is not None else None

    def command_refusal(self) -> str | None:
        """Return why this service accepts no override; None where it does."""
        if self._peer.follows(self._clock()):
            return "the other service is active and keeps the overrides of both: give it there, or take over first"
        return None

    def snapshot(self) -> StandbySnapshot:
        """Return the state of both services, for observers."""
        return self._peer.snapshot(self._clock())

    def _receive(self, sign: SignOfLife) -> None:
        self._peer.receive(sign, self._clock())
        self._synchronise()
        self._send_due()

    def _tick(self) -> None:
        now_s = self._clock()
        self._peer.tick(now_s, self._engine.aiding.to_change())
        self._timer.by(self._peer.next_tick_s(now_s))
        self._synchronise()
        self._send_due()

    def _send_due(self) -> None:
        if not self._is_behind() and self._peer.sign_is_due(self._clock()):
            self._send_sign()

    def _send_sign(self) -> None:
        overrides = tuple(OverrideInForce(command.sysid, command.override) for command in self._engine.overrides())
        self._link.send(self._peer.sign_of_life(self._clock(), overrides, self._engine.aiding.switched()))

    def _synchronise(self) -> None:
        """Have the engine know what the state machine decided, and what the other service has in force."""
        now_s, peer = self._clock(), self._peer
        if peer.follows(now_s):
            self._follow(now_s)
        is_held_back = peer.state is not StandbyState.ACTIVE
        if is_held_back is not self.is_held_back:
            self.is_held_back = is_held_back
            self._apply(HoldBack(now_s, held=is_held_back))
        stands = (peer.state, peer.reason)
        if stands != self._told:
            self._told = stands
            level = _LEVELS.get(peer.reason.reason, "info")
            self._publish(Notice(now_s, None, level, f"{_WORDS[peer.state]}: {peer.reason.text}"))

    def _follow(self, now_s: float) -> None:
        """Make the other service's overrides and switches ours, so that a take-over changes neither."""
        shared = self._peer.shared
        theirs = {(each.sysid, type(each.override)): each.override for each in shared.overrides}
        ours: dict[tuple[int, type[Override]], Override] = {
            (command.sysid, type(command.override)): command.override for command in self._engine.overrides()
        }
        automatic: dict[type[Override], Override] = {type(each): each for each in _AUTOMATIC}
        for sysid, kind in theirs.keys() | ours.keys():
            wanted = theirs.get((sysid, kind), automatic[kind])
            if ours.get((sysid, kind), automatic[kind]) is not wanted:
                self._apply(OperatorCommand(sysid, now_s, wanted, CommandSource.OTHER_SERVICE))
        switched = self._engine.aiding.switched()
        for receiver in set(switched) - set(shared.switched):
            self._apply(SwitchedByOther(now_s, receiver, held=False))
        for receiver in set(shared.switched) - set(switched):
            self._apply(SwitchedByOther(now_s, receiver, held=True))
