"""One fleet's alarms in the service: kept up to date and passed on."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from gcs_coloc.core.alarms.alarms import Alarm, AlarmList
from gcs_coloc.core.alarms.status_texts import StatusText, StatusTexts
from gcs_coloc.core.messages.outbound import Notice, ToOperator
from gcs_coloc.core.snapshot import FleetSnapshot
from gcs_coloc.runtime.clock import ServiceClock
from gcs_coloc.sinks.event_bus import EventBus


class AlarmDesk:
    """Keeps the list of alarms and passes on what changes in it.

    A change goes to `events` and `record`, and to the ground tools where `tells_ground_tools` is set.
    """

    def __init__(
        self, clock: ServiceClock, events: EventBus, record: Callable[[Alarm], None], *, tells_ground_tools: bool
    ) -> None:
        self._clock = clock
        self._events = events
        self._record = record
        self._alarms = AlarmList()
        self._status_texts = StatusTexts() if tells_ground_tools else None

    @property
    def tells_ground_tools(self) -> bool:
        """Whether alarms are sent to ground tools."""
        return self._status_texts is not None

    def update(self, fleet: FleetSnapshot) -> tuple[Alarm, ...]:
        """Update the alarms from a snapshot of the fleet, and return those in the list."""
        self._publish(self._alarms.update(fleet))
        return tuple(self._alarms)

    def acknowledge(self, alarm_id: int) -> bool:
        """Acknowledge an alarm; False where none of that id waits for it."""
        changed = self._alarms.acknowledge(alarm_id, self._clock())
        self._publish(changed)
        return bool(changed)

    def publish(self, message: ToOperator) -> None:
        """Publish what the operator is to know; a notice is an alarm, too, where it is serious."""
        self._events.publish(message)
        if isinstance(message, Notice):
            self._publish(self._alarms.add_notice(message))

    def pop_status_texts(self, now_s: float) -> list[StatusText]:
        """Return the texts for ground tools of the second from service time `now_s` (s)."""
        return self._status_texts.pop_due(now_s) if self._status_texts is not None else []

    def _publish(self, changed: Iterable[Alarm]) -> None:
        for alarm in changed:
            self._events.publish(alarm)
            self._record(alarm)
            if self._status_texts is not None:
                self._status_texts.add(alarm)
