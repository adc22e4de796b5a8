"""The journal's entries as JSON, with a schema of each kind."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import TypeAdapter

from gcs_coloc.core.alarms.alarms import Alarm
from gcs_coloc.core.messages.outbound import HealthChanged, Notice
from gcs_coloc.recorder.journal import Entry, RangeEntry, StationEntry, VehicleEntry

NAMES: Mapping[type, str] = {
    VehicleEntry: "vehicle",
    RangeEntry: "range",
    StationEntry: "station",
    HealthChanged: "health",
    Notice: "notice",
    Alarm: "alarm",
}
_ADAPTERS: Mapping[type, TypeAdapter[Any]] = {kind: TypeAdapter(kind) for kind in NAMES}


def as_json(entry: Entry) -> bytes:
    """An entry as one JSON object; a number that is not finite becomes null."""
    encoded: bytes = _ADAPTERS[type(entry)].dump_json(entry)
    return encoded


def schema_of(kind: type) -> dict[str, Any]:
    """The JSON schema of one kind of entry, without references: some viewers follow none."""
    schema = _ADAPTERS[kind].json_schema(mode="serialization")
    definitions = schema.pop("$defs", {})
    inlined: dict[str, Any] = _inline(schema, definitions)
    return inlined


def _inline(part: Any, definitions: Mapping[str, Any]) -> Any:
    if isinstance(part, list):
        return [_inline(item, definitions) for item in part]
    if not isinstance(part, dict):
        return part
    if "$ref" in part:
        return _inline(definitions[part["$ref"].rpartition("/")[2]], definitions)
    return {key: _inline(value, definitions) for key, value in part.items()}
