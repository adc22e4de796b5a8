"""A graph of objects is copied as it is, shared memory and all, or refused with the reason."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

from gcs_coloc.core.gps_health.gps_health import GpsState
from gcs_coloc.estimators.fleet.ekf._kernels import Transition
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.recorder.freeze import FreezeError, freeze, thaw


def again(graph):
    """A copy of a copy: what was thawed can be frozen."""
    return thaw(freeze(thaw(freeze(graph))))


def test_views_of_an_array_are_views_of_its_copy_with_the_strides_that_they_had():
    P = np.arange(64.0).reshape(8, 8)
    views = {
        "rows": P[2:5],
        "column": P[:, 3],
        "turned": P.T,
        "backwards": P[::-2, 1],
        "diagonal": P.diagonal(),
        "of a view": P[1:7].T[2:4],
        "repeated": np.broadcast_to(P[0], (3, 8)),
        "bytes": P.view(np.uint8)[0],
    }
    graph = again({"P": P, "views": views})
    for name, view in views.items():
        copied = graph["views"][name]
        assert (copied.shape, copied.strides, copied.dtype) == (view.shape, view.strides, view.dtype), name
        assert np.array_equal(copied, view), name
        assert np.shares_memory(copied, graph["P"]), name
        assert not np.shares_memory(copied, P), name
    graph["P"][2, 3] = -1.0
    assert graph["views"]["rows"][0, 3] == graph["views"]["column"][2] == graph["views"]["turned"][3, 2] == -1.0
    assert P[2, 3] == 19.0


def test_an_array_whose_views_alone_are_left_is_copied_with_them():
    pair = dict(zip("ab", np.asfortranarray(np.arange(60.0).reshape(6, 10)).reshape(2, 3, 10), strict=True))
    graph = again(pair)
    assert all(np.array_equal(graph[key], pair[key]) and graph[key].strides == pair[key].strides for key in pair)
    assert np.array_equal(again(np.zeros((4, 0)).T[1:]), np.zeros((0, 4))[1:])


@dataclass(slots=True)
class Node:
    state: GpsState
    others: deque[Node] = field(default_factory=lambda: deque(maxlen=3))
    on_news: object = None

    def tell(self) -> Node:
        return self


def test_circles_bound_methods_enumerations_and_read_only_mappings_stay_what_they_are():
    node, table = Node(GpsState.FAILED), {1: 2.0}
    node.others.append(node)
    node.on_news = node.tell
    copied, shown, under = again((node, MappingProxyType(table), table))
    assert copied.others[0] is copied
    assert copied.others.maxlen == 3
    assert copied.on_news() is copied
    assert copied.state is GpsState.FAILED
    under[1] = 3.0
    assert shown[1] == 3.0


def test_the_room_to_work_in_of_a_step_is_made_anew():
    step = again({"step": Transition()})["step"]
    step.set_motion((0.0,) * 16, 0.5, 0.1, in_wind=True)
    assert step.F[0, 3] != 0.0


PLUGIN = """
def helper():
    return 7


class Mine:
    name = "mine"

    def __init__(self):
        self.work = helper

    def set_denied(self, denied, at_s): ...
    def reset(self, vehicle, at_s): ...
    def add(self, measurement): ...
    def estimate(self, vehicle, at_s): ...
    def drain_residuals(self): ...
    def counts(self): ...
"""


def test_what_comes_from_a_plug_ins_file_is_found_again(tmp_path):
    (tmp_path / "a.b").mkdir()
    path = tmp_path / "a.b" / "mine.py"
    path.write_text(PLUGIN)
    mine = load_estimator(f"{path}:Mine", {})
    copied = again(mine)
    assert type(copied) is type(mine)
    assert copied is not mine
    assert copied.work() == 7


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: lambda: 0, "lambda"),
        (lambda: (n for n in ()), "generator"),
        (lambda: Path(__file__).open(), "TextIOWrapper"),  # noqa: SIM115
        (lambda: memoryview(b"x"), "memoryview"),
        (lambda: np.frombuffer(bytearray(800)), "the memory of a bytearray"),
    ],
)
def test_what_cannot_be_copied_is_refused_with_the_reason(make, words):
    held = make()
    with pytest.raises(FreezeError, match=words):
        freeze({"held": held})
    if hasattr(held, "close"):
        held.close()


class Thorny:
    def __setstate__(self, state):
        raise RuntimeError("not twice")


def test_what_cannot_be_made_again_is_an_error_with_the_reason():
    thorny = Thorny()
    thorny.x = 1
    with pytest.raises(FreezeError, match="RuntimeError: not twice"):
        thaw(freeze(thorny))
