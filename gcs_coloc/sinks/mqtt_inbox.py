"""What comes in over MQTT: commands and ranges, each only where the settings allow it. What is refused is counted by reason."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass

from pydantic import ValidationError

from gcs_coloc.core.messages.control import Override
from gcs_coloc.core.messages.inbound import PeerRange
from gcs_coloc.core.snapshot import FleetSnapshot
from gcs_coloc.mavlink.counts import Counts
from gcs_coloc.sinks.mqtt_models import Command, Range

_MOST_BYTES = 1000


@dataclass(frozen=True, slots=True)
class MqttHooks:
    """What the MQTT side may ask of the service.

    `look` is the fleet as it stands, `heard` the system ids heard so far, `obey` takes the operator's word, `take_range`
    a range; `clock` is the service's, in seconds.
    """

    snapshot: Callable[[], FleetSnapshot]
    known_sysids: Callable[[], Collection[int]]
    apply_command: Callable[[int, Override], None]
    add_range: Callable[[PeerRange], None]
    clock: Callable[[], float]


class MqttInbox:
    """Takes messages below `base`, a topic; counts into `counts`."""

    def __init__(self, base: str, hooks: MqttHooks, counts: Counts, *, commands: bool, ranges: bool) -> None:
        self._base = base
        self._hooks = hooks
        self._counts = counts
        self._allowed = [name for name, allowed in (("cmd", commands), ("range", ranges)) if allowed]

    @property
    def topics(self) -> list[str]:
        """The topics to subscribe to; none where nothing is allowed."""
        return [f"{self._base}/+/{name}" for name in self._allowed]

    def receive(self, topic: str, payload: bytes, *, retained: bool) -> None:
        """Take one message. Never raises for its content."""
        reason = self._refusal(topic, payload, retained)
        if reason is not None:
            self._counts.add(f"mqtt_{reason}")

    def _refusal(self, topic: str, payload: bytes, retained: bool) -> str | None:
        sysid_text, _, name = topic.removeprefix(f"{self._base}/").partition("/")
        if name not in self._allowed:
            return "topic_not_allowed"
        if retained:
            # A retained word would be obeyed anew with every reconnection, long after it was meant.
            return f"{name}_retained"
        if len(payload) > _MOST_BYTES:
            return f"{name}_too_long"
        sysid = int(sysid_text) if sysid_text.isascii() and sysid_text.isdigit() and len(sysid_text) <= 3 else None
        if sysid is None or sysid not in self._hooks.known_sysids():
            return f"{name}_of_unknown_vehicle"
        try:
            if name == "cmd":
                self._hooks.apply_command(sysid, Command.model_validate_json(payload).override())
                return None
            found = Range.model_validate_json(payload)
        except ValidationError:
            return f"{name}_invalid"
        if found.peer == sysid:
            return "range_to_itself"
        self._hooks.add_range(found.message(sysid, self._hooks.clock()))
        return None
