"""Every setting is documented under itself and bounded, and the reference pages are made from the settings' classes."""

from __future__ import annotations

import tomllib
from dataclasses import fields, is_dataclass

import pytest

from gcs_coloc.config.examples import EXAMPLES
from gcs_coloc.config.settings import Settings
from gcs_coloc.core.setting_bounds import Bounds, check_bounds, field_bounds
from tools.settings_reference import OF_EACH, PAGES, field_texts, written

SECTIONS = {name: type(getattr(Settings(), name)) for name in Settings.model_fields if name not in ("links", "out", *OF_EACH)}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_tables_of_the_reference_are_those_of_the_classes(page):
    text = page.read_text(encoding="utf-8")
    assert "<!-- settings: " in text
    assert written(text) == text, "run make reference"


@pytest.mark.parametrize(
    "section",
    [*SECTIONS.values(), *OF_EACH.values()],
    ids=[*SECTIONS, *OF_EACH],
)
def test_every_setting_is_documented_under_itself(section):
    names = [one.name for one in fields(section)] if is_dataclass(section) else list(section.model_fields)
    texts = field_texts(section)
    assert names
    assert not [name for name in names if not texts.get(name, "").endswith(".")]


def test_every_number_of_the_cores_settings_has_bounds_and_a_default_within():
    for section in SECTIONS.values():
        if is_dataclass(section):
            numbers = [one for one in fields(section) if type(one.default) in (int, float)]
            assert numbers
            assert not [one.name for one in numbers if field_bounds(one) is None or not field_bounds(one).admit(one.default)]
            check_bounds(section())


@pytest.mark.parametrize(
    ("bounds", "inside", "outside", "text"),
    [
        (Bounds(0.0, open_below=True), [1e-9, 1e9], [0.0, -1.0, float("inf"), float("nan")], "above 0"),
        (Bounds(1.0, 50.0), [1.0, 50.0], [0.9, 51.0], "from 1 to 50"),
        (Bounds(0.0), [0.0, 7.0], [-0.1, float("inf")], "at least 0"),
        (Bounds(0.0, 1.0, open_below=True), [1.0], [0.0, 1.1], "above 0, at most 1"),
    ],
)
def test_bounds_admit_what_they_say(bounds, inside, outside, text):
    assert str(bounds) == text
    assert all(bounds.admit(value) for value in inside)
    assert not any(bounds.admit(value) for value in outside)


TABLES_OF_THEIR_OWN = {"names"}
"""They stand in the file as a comment: an empty table would hide what belongs in it."""


def test_the_example_configuration_holds_every_setting_with_its_default():
    file = tomllib.loads((EXAMPLES / "default.toml").read_text(encoding="utf-8"))
    told = Settings.model_validate({name: file[name] for name in SECTIONS})
    for name, section in SECTIONS.items():
        names = [one.name for one in fields(section)] if is_dataclass(section) else list(section.model_fields)
        assert set(file[name]) == set(names) - TABLES_OF_THEIR_OWN
        assert getattr(told, name) == getattr(Settings(), name)


CORE = [section for section in SECTIONS.values() if is_dataclass(section)]


@pytest.mark.parametrize("made", CORE, ids=lambda made: made.__name__)
def test_a_number_out_of_bounds_is_refused_by_name(made):
    one = next(each for each in fields(made) if type(each.default) in (int, float))
    with pytest.raises(ValueError, match=f"{one.name} must be"):
        made(**{one.name: -1.0})
