"""The settings of the built-in estimators: their reference pages are up to date, and bad values name their key."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Literal

import pytest

from gcs_coloc.core.errors import DataError, EstimatorError
from gcs_coloc.estimators.registry import load_class, load_estimator, settings_type_of
from gcs_coloc.estimators.settings_reference import settings_table, updated_page
from gcs_coloc.estimators.validation import Bounds, bounds_of, check_settings

DOCUMENTED = ("qu_zhang",)
REFERENCE = Path(__file__).parents[3] / "docs" / "reference"


@pytest.mark.parametrize("name", DOCUMENTED)
def test_the_reference_page_equals_the_generators_output(name):
    path = REFERENCE / f"estimator-{name.replace('_', '-')}.md"
    page = path.read_text(encoding="utf-8")
    settings_type = settings_type_of(name, load_class(name))
    assert page == updated_page(page, settings_type), "run python -m gcs_coloc.estimators.settings_reference docs/reference"


@pytest.mark.parametrize("name", DOCUMENTED)
def test_every_number_has_bounds_and_its_default_is_within(name):
    settings_type = settings_type_of(name, load_class(name))
    bounds = bounds_of(settings_type)
    for one in fields(settings_type):
        if not isinstance(one.default, bool):
            assert one.name in bounds, one.name
    check_settings(settings_type())


@pytest.mark.parametrize("name", DOCUMENTED)
def test_a_value_out_of_bounds_is_refused_with_the_key(name):
    for key, allowed in bounds_of(settings_type_of(name, load_class(name))).items():
        wrong = "nothing" if isinstance(allowed, tuple) else -1
        with pytest.raises(EstimatorError, match=key):
            load_estimator(name, {key: wrong})


@dataclass(frozen=True)
class Example:
    share: Annotated[float, Bounds(least=0.0, below=1.0)] = 0.5
    """A share, of
    something."""
    mode: Literal["calm", "eager"] = "calm"
    """One | other."""
    on: bool = False
    """Whether."""

    def __post_init__(self) -> None:
        check_settings(self)


@pytest.mark.parametrize("share", [-0.1, 1.0, math.nan, math.inf])
def test_bounds_are_checked_and_named(share):
    with pytest.raises(EstimatorError, match=f"share is {share}; it must be at least 0 and below 1"):
        Example(share=share)
    with pytest.raises(EstimatorError, match="mode is 'wild'; it must be 'calm' or 'eager'"):
        Example(mode="wild")
    assert Example(share=0.0, mode="eager").share == 0.0


def test_the_table_has_name_default_bounds_and_the_docstring_of_each_field():
    assert settings_table(Example).splitlines()[2:] == [
        "| `share` | `0.5` | at least 0 and below 1 | A share, of something. |",
        '| `mode` | `"calm"` | `"calm"`, `"eager"` | One \\| other. |',
        "| `on` | `false` | `true`, `false` | Whether. |",
    ]


@dataclass(frozen=True)
class Undocumented:
    share: float = 0.5


def test_a_field_without_a_docstring_and_a_page_without_the_mark_are_errors():
    with pytest.raises(EstimatorError, match=r"Undocumented\.share has no docstring"):
        settings_table(Undocumented)
    with pytest.raises(DataError, match="needs the line"):
        updated_page("# A page\n", Example)
