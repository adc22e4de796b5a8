"""What vehicles say reaches somebody, whatever kind of message it is."""

from __future__ import annotations

from dataclasses import fields
from enum import Enum
from typing import Any, get_args, get_type_hints

import pytest

from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages.inbound import FromVehicle
from gcs_coloc.estimators.registry import load_estimator


def _any_value(kind: Any) -> Any:
    if type(None) in get_args(kind):
        return None
    return next(iter(kind)) if issubclass(kind, Enum) else kind(1)


@pytest.mark.parametrize("kind", get_args(FromVehicle), ids=lambda kind: kind.__name__)
def test_every_kind_of_message_of_a_vehicle_has_a_taker(kind):
    hints = get_type_hints(kind)
    engine = Engine(load_estimator("fleet", {}))
    engine.receive(kind(**{field.name: _any_value(hints[field.name]) for field in fields(kind)}))
    assert engine.sysids() == [1]
