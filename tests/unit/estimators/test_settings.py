"""The settings of the built-in estimators: their reference pages are up to date, and bad values name their key."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Literal

import pytest

from gcs_coloc.core.errors import DataError, EstimatorError
from gcs_coloc.core.setting_bounds import Bounds
from gcs_coloc.estimators.registry import BUILT_IN, load_class, load_estimator, settings_type_of
from gcs_coloc.estimators.settings_reference import field_docstrings, settings_table, updated_page
from gcs_coloc.estimators.validation import bounds_of, check_settings

REFERENCE = Path(__file__).parents[3] / "docs" / "reference"
TYPES = {name: settings_type_of(name, load_class(name)) for name in BUILT_IN}
FIELDS = [(name, one.name) for name, settings_type in TYPES.items() for one in fields(settings_type)]
BOUNDED = [(name, key, bounds) for name, one in TYPES.items() for key, bounds in bounds_of(one).items()]
NUMBERS = [(name, key) for name, key, bounds in BOUNDED if isinstance(bounds, Bounds)]


@pytest.mark.parametrize("name", BUILT_IN)
def test_the_reference_page_equals_the_generators_output(name):
    page = (REFERENCE / f"estimator-{name.replace('_', '-')}.md").read_text(encoding="utf-8")
    assert page == updated_page(page, TYPES[name]), "run python -m gcs_coloc.estimators.settings_reference docs/reference"


@pytest.mark.parametrize(("name", "key"), FIELDS)
def test_the_text_under_a_setting_states_its_bounds_and_where_its_default_comes_from(name, key):
    text, bounds = field_docstrings(TYPES[name])[key], bounds_of(TYPES[name]).get(key)
    assert "Chosen:" in text
    if isinstance(bounds, Bounds):
        assert f", {bounds.least:g} to {bounds.most:g}. " in text
    else:
        assert isinstance(getattr(TYPES[name](), key), (bool, str))


@pytest.mark.parametrize(("name", "key"), NUMBERS)
def test_a_setting_beyond_its_bounds_is_refused_by_its_name(name, key):
    bounds = bounds_of(TYPES[name])[key]
    least, most = bounds.least, bounds.most
    for value in (least, most):
        assert getattr(TYPES[name](**{key: value}), key) == value
    for value in (least - 1.0, most + 1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match=rf"^{key} = .*: it must be from"):
            TYPES[name](**{key: value})


@pytest.mark.parametrize(("key", "value"), [("gate_sigma", 0), ("window_s", -1)])
def test_what_a_configuration_gives_beyond_the_bounds_is_refused_in_one_line(key, value):
    with pytest.raises(EstimatorError, match=rf"^estimator 'fleet' refuses its settings: {key} = "):
        load_estimator("fleet", {key: value})


@pytest.mark.parametrize("old", TYPES["fleet"].RENAMED)
def test_a_setting_of_version_0_1_is_refused_with_its_new_name(old):
    new = TYPES["fleet"].RENAMED[old]
    assert ("fleet", new) in NUMBERS
    with pytest.raises(EstimatorError, match=f"the setting '{old}' is called '{new}' now"):
        load_estimator("fleet", {old: 1.0})


@dataclass(frozen=True)
class Example:
    share: Annotated[float, Bounds(0.0, 1.0)] = 0.5
    """A share, of
    something."""
    mode: Literal["calm", "eager"] = "calm"
    """One | other."""
    on: bool = False
    """Whether."""

    def __post_init__(self) -> None:
        check_settings(self)


def test_a_literal_is_checked():
    with pytest.raises(ValueError, match="mode = 'wild': it must be 'calm' or 'eager'"):
        Example(mode="wild")
    assert Example(share=0.0, mode="eager").share == 0.0


def test_the_table_has_name_default_and_the_docstring_of_each_field():
    assert settings_table(Example).splitlines()[2:] == [
        "| `share` | `0.5` | A share, of something. |",
        '| `mode` | `"calm"` | One \\| other. |',
        "| `on` | `false` | Whether. |",
    ]


@dataclass(frozen=True)
class Undocumented:
    share: float = 0.5


def test_a_field_without_a_docstring_and_a_page_without_the_mark_are_errors():
    with pytest.raises(EstimatorError, match=r"Undocumented\.share has no docstring"):
        settings_table(Undocumented)
    with pytest.raises(DataError, match="needs the line"):
        updated_page("# A page\n", Example)
