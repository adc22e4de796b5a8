"""One fleet's datagrams through decoder, engine and encoder, as the service takes them, without sockets and on their own time."""

from __future__ import annotations

from collections.abc import Iterable

from bench.traffic import Sent
from gcs_coloc.core.deadlines import advance
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages.control import ClockReference, RouteReport
from gcs_coloc.core.messages.outbound import ToVehicle
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.mavlink.decoder import Decoder
from gcs_coloc.mavlink.encoder import Encoder

_UNIX_S = 1.78e9


class Flight:
    """The straight path of one fleet; `sent` counts the frames that it would have sent."""

    def __init__(self) -> None:
        self.engine = Engine(load_estimator("fleet", {}))
        self.decoder = Decoder()
        self.sent = 0
        self._encoder = Encoder()
        self.engine.receive(ClockReference(0.0, _UNIX_S))

    def fly(self, datagrams: Iterable[Sent]) -> None:
        """Receive datagrams in order of time, and answer every deadline in between."""
        for at_s, sysid, payload in datagrams:
            self.advance(at_s)
            self.receive(at_s, sysid, payload)

    def advance(self, to_s: float) -> None:
        """Answer the deadlines before a time, and encode what is to be sent."""
        for _, outputs in advance(self.engine, to_s):
            for output in outputs:
                if isinstance(output, ToVehicle):
                    self._encoder.encode(output, output.sysid)
                    self.sent += 1

    def receive(self, at_s: float, sysid: int, payload: bytes) -> None:
        """Give one datagram to the engine."""
        for frame in self.decoder.decode(payload, at_s, sysid):
            if frame.message is not None:
                self.engine.receive(frame.message)
            if frame.is_autopilot_heartbeat:
                self.engine.receive(RouteReport(frame.sysid, at_s, None))
