"""Two hosts in containers on a real engine: the page of all fleets shows both, and which one is not heard any more."""

from __future__ import annotations

import re
from urllib.error import HTTPError

import containers
import pytest
from brokers import wait_until

pytestmark = [pytest.mark.integration, pytest.mark.timeout(600)]

PATIENCE_S = 180.0
"""Two services and a page start beside each other, on two cores with others' tests."""
AIRCRAFT = ("a1", "a2", "b1", "b2")


@pytest.fixture
def hosts():
    lacking = containers.missing()
    if lacking is not None:
        pytest.skip(f"the containers are not tested: {lacking}")
    hosts = containers.Demo("compose.two-hosts.yaml")
    try:
        hosts.build("secrets")
        hosts.compose("up", "--detach", "watch", *AIRCRAFT)
        yield hosts
    finally:
        hosts.compose("down", "--volumes", "--remove-orphans", "--timeout", "2")
    assert hosts.left() == []


def watched(hosts, page) -> dict[str, float]:
    """How many fleets there are of each presence, and vehicles of each light, by the metrics of the page."""
    try:
        text = hosts.fetch(f"{page}metrics")
    except OSError:  # not served yet
        return {}
    found = re.findall(r'gcs_coloc_watch_(?:fleets|vehicles)\{(?:presence|light)="(\w+)"\} (\S+)', text)
    return {name: float(number) for name, number in found}


def is_ready(hosts, page) -> bool:
    """Whether the page says that all fleets are heard."""
    try:
        return hosts.fetch(f"{page}readyz") == "ok\n"
    except HTTPError:  # 503 with what is lacking
        return False


def test_both_fleets_are_live_and_the_one_whose_broker_is_gone_is_told_within_its_time(hosts):
    page = hosts.page("watch")

    def all_are_heard() -> bool:
        counts = watched(hosts, page)
        vehicles = sum(counts.get(light, 0.0) for light in ("good", "caution", "bad", "unknown"))
        return counts.get("live") == 2.0 and vehicles == len(AIRCRAFT) and is_ready(hosts, page)

    wait_until(all_are_heard, PATIENCE_S)
    hosts.compose("kill", "broker-b")
    wait_until(lambda: {"live": 1.0, "stale": 1.0}.items() <= watched(hosts, page).items(), PATIENCE_S)
