"""The settings of the built-in estimators: their reference pages are up to date, and bad values name their key."""

from __future__ import annotations

import math
from dataclasses import fields

import pytest

from gcs_coloc.core.errors import EstimatorError
from gcs_coloc.core.setting_bounds import field_bounds
from gcs_coloc.estimators.qu_zhang.settings import QuZhangSettings
from gcs_coloc.estimators.registry import BUILT_IN, load_class, load_estimator, settings_type_of
from tools.settings_reference import field_texts

TYPES = {name: settings_type_of(name, load_class(name)) for name in BUILT_IN}
FIELDS = [(name, one.name) for name, settings_type in TYPES.items() for one in fields(settings_type)]
BOUNDS = {(name, one.name): field_bounds(one) for name, settings_type in TYPES.items() for one in fields(settings_type)}
NUMBERS = [key for key, bounds in BOUNDS.items() if bounds is not None]


@pytest.mark.parametrize(("name", "key"), FIELDS)
def test_the_text_under_a_setting_says_where_its_default_comes_from_and_a_number_has_bounds(name, key):
    assert "Chosen:" in field_texts(TYPES[name])[key]
    assert (name, key) in NUMBERS or isinstance(getattr(TYPES[name](), key), (bool, str))


@pytest.mark.parametrize(("name", "key"), NUMBERS)
def test_a_setting_beyond_its_bounds_is_refused_by_its_name(name, key):
    bounds = BOUNDS[name, key]
    least, most = bounds.least, bounds.most
    for value in (least, most):
        assert getattr(TYPES[name](**{key: value}), key) == value
    for value in (least - 1.0, most + 1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match=rf"^{key} must be from"):
            TYPES[name](**{key: value})


@pytest.mark.parametrize(("key", "value"), [("gate_sigma", 0), ("window_s", -1)])
def test_what_a_configuration_gives_beyond_the_bounds_is_refused_in_one_line(key, value):
    with pytest.raises(EstimatorError, match=rf"^estimator 'fleet' refuses its settings: {key} must be "):
        load_estimator("fleet", {key: value})


@pytest.mark.parametrize("old", TYPES["fleet"].RENAMED)
def test_a_setting_of_version_0_1_is_refused_with_its_new_name(old):
    new = TYPES["fleet"].RENAMED[old]
    assert ("fleet", new) in NUMBERS
    with pytest.raises(EstimatorError, match=f"the setting '{old}' is called '{new}' now"):
        load_estimator("fleet", {old: 1.0})


def test_a_covariance_that_does_not_exist_is_refused():
    with pytest.raises(ValueError, match="covariance must be 'corrected' or 'published' or 'constant', not 'wild'"):
        QuZhangSettings(covariance="wild")
