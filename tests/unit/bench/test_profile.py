"""The benchmark's profile puts what py-spy saw into shares of the parts of the service."""

from bench.profile import shares_by_part

_LOOP = "<module> (gcs_coloc/__main__.py:9);run (asyncio/runners.py:190);BaseEventLoop._run_once (asyncio/base_events.py:1922)"
_ENGINE = "Engine.receive (gcs_coloc/core/engine.py:120)"
_TOOK = f"{_LOOP};Handle._run (asyncio/events.py:80);take (gcs_coloc/links/udp.py:70)"


def test_the_innermost_part_of_the_service_counts_whatever_library_it_calls():
    stacks = [
        f"{_TOOK};{_ENGINE};apply (gcs_coloc/estimators/fleet/filter.py:90);dot (numpy.py:3) 7",
        f"{_TOOK};{_ENGINE};test (gcs_coloc/core/integrity/judge.py:40) 5",
        f"{_TOOK};{_ENGINE} 2",
        f"{_TOOK} 3",
        f"{_LOOP} 1",
        f"{_LOOP};Handle._run (asyncio/events.py:80) 1",
    ]
    assert shares_by_part(stacks, within="BaseEventLoop._run_once") == {
        "filter": 7,
        "ranges against GPS positions (integrity)": 5,
        "engine: health, clocks, frames, noise": 2,
        "receiving, routes, sending": 3,
        "event loop and the rest": 2,
    }


def test_what_is_done_outside_the_function_that_is_asked_for_does_not_count():
    stacks = ["<module> (gcs_coloc/__main__.py:9);load (gcs_coloc/config.py:3) 40", f"{_TOOK} 3"]
    assert shares_by_part(stacks, within="BaseEventLoop._run_once") == {"receiving, routes, sending": 3}
