"""News for the operator in words: the same on the page, on MQTT and in the log."""

from __future__ import annotations

from gcs_coloc.core.messages.outbound import HealthChanged, ToOperator


def level_and_text(news: ToOperator) -> tuple[str, str]:
    """How serious a piece of news is (`info`, `warning`, `error`), and what it says. What is not `info` is an alarm."""
    if isinstance(news, HealthChanged):
        bad = news.after in ("suspect", "failed")
        return ("warning" if bad else "info"), f"GPS {news.before} -> {news.after}: {news.reason}"
    return news.level, news.text
