"""Every topic and field on MQTT stands in the reference, and the published schemas are those of the models."""

import json
from pathlib import Path

import pytest

from gcs_coloc.sinks.mqtt_models import BY_TOPIC, schemas

REFERENCE = Path(__file__).resolve().parents[3] / "docs/reference"
TEXT = (REFERENCE / "mqtt.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("topic", BY_TOPIC)
def test_every_topic_is_in_the_reference_with_every_field(topic):
    assert f"\n| `{topic}` |" in TEXT
    # The section of a topic's fields begins with the topic at the beginning of a line.
    section = TEXT[TEXT.index(f"\n`{topic}`") :]
    table = section[: section.index("\n\n", section.index("|---"))]
    cells = [line.split("|")[1] for line in table.splitlines() if line.startswith("| `")]
    for field in BY_TOPIC[topic].model_fields:
        known = TEXT if field == "at_unix_s" else "".join(cells)
        assert f"`{field}`" in known, f"{topic}: {field}"


def test_the_published_schemas_are_those_of_the_models():
    published = json.loads((REFERENCE / "schemas/mqtt-v2.json").read_text(encoding="utf-8"))
    assert published == schemas(), "renew it: python -m gcs_coloc.sinks.mqtt_models > docs/reference/schemas/mqtt-v2.json"
