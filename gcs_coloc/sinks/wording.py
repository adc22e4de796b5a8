"""The wording of events for the operator: the same on the page, on MQTT and in the log."""

from __future__ import annotations

from gcs_coloc.core.messages.outbound import HealthChanged, ToOperator


def level_and_text(event: ToOperator) -> tuple[str, str]:
    """The level of an event (`info`, `warning`, `error`) and its text. What is not `info` is an alarm."""
    if isinstance(event, HealthChanged):
        bad = event.after in ("suspect", "failed")
        return ("warning" if bad else "info"), f"GPS {event.before} -> {event.after}: {event.reason}"
    return event.level, event.text
