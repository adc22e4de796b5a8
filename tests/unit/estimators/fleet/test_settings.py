"""Each setting of the fleet filter is documented with its bounds, and refused by its name beyond them."""

import ast
import inspect
import math

import pytest

from gcs_coloc.core.errors import EstimatorError
from gcs_coloc.estimators.fleet.settings import BOUNDS, FleetSettings
from gcs_coloc.estimators.registry import load_estimator


def documented() -> dict[str, str]:
    """The string literal directly under each field."""
    body = ast.parse(inspect.getsource(FleetSettings)).body[0]
    assert isinstance(body, ast.ClassDef)
    return {
        field.target.id: text.value.value
        for field, text in zip(body.body, body.body[1:], strict=False)
        if isinstance(field, ast.AnnAssign)
        and isinstance(field.target, ast.Name)
        and isinstance(text, ast.Expr)
        and isinstance(text.value, ast.Constant)
    }


@pytest.mark.parametrize("name", BOUNDS)
def test_the_text_under_a_setting_states_its_bounds_and_where_its_default_comes_from(name):
    text, (least, most) = documented()[name], BOUNDS[name]
    assert f"{least:g} to {most:g}." in text
    assert "Chosen:" in text


@pytest.mark.parametrize("name", BOUNDS)
def test_a_setting_beyond_its_bounds_is_refused_by_its_name(name):
    least, most = BOUNDS[name]
    for value in (least, most):
        assert getattr(FleetSettings(**{name: value}), name) == value
    for value in (least - 1.0, most + 1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match=rf"^{name} = .*: it must be from"):
            FleetSettings(**{name: value})


@pytest.mark.parametrize(("key", "value"), [("gate_sigma", 0), ("window_s", -1)])
def test_what_a_configuration_gives_beyond_the_bounds_is_refused_in_one_line(key, value):
    with pytest.raises(EstimatorError, match=rf"^estimator 'fleet' refuses its settings: {key} = "):
        load_estimator("fleet", {key: value})


@pytest.mark.parametrize("old", FleetSettings.RENAMED)
def test_a_setting_of_version_0_1_is_refused_with_its_new_name(old):
    new = FleetSettings.RENAMED[old]
    assert new in BOUNDS
    with pytest.raises(EstimatorError, match=f"the setting '{old}' is called '{new}' now"):
        load_estimator("fleet", {old: 1.0})
