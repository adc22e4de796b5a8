"""Which signals end a program that serves, and under nohup which does not."""

from __future__ import annotations

import asyncio
import io
import signal

import pytest

from gcs_coloc.config.service_sections import MqttConfig, WebConfig
from gcs_coloc.service.watch import Watch
from gcs_coloc.sinks.terminal import SharedConsole

PATIENCE_S = 60.0


@pytest.fixture(params=[signal.SIG_DFL, signal.SIG_IGN])
def terminal(request):
    """What a closed terminal does to the program: its default, or nothing as under nohup."""
    before = signal.signal(signal.SIGHUP, request.param)
    yield request.param
    signal.signal(signal.SIGHUP, before)


def test_a_terminal_that_closes_ends_the_watch_unless_it_runs_under_nohup(terminal, monkeypatch):
    monkeypatch.setattr("gcs_coloc.service.watch.exclude_start", lambda: None)

    async def scenario():
        watch = Watch(MqttConfig(host="127.0.0.1", port=1), WebConfig(on=False))
        running = asyncio.create_task(watch.run(SharedConsole(file=io.StringIO())))
        await asyncio.sleep(0)
        signal.raise_signal(signal.SIGHUP)
        await asyncio.wait([running], timeout=PATIENCE_S if terminal is signal.SIG_DFL else 0.2)
        assert running.done() == (terminal is signal.SIG_DFL)
        if terminal is signal.SIG_IGN:
            signal.raise_signal(signal.SIGTERM)
        await asyncio.wait_for(running, PATIENCE_S)

    asyncio.run(scenario())
