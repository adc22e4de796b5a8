import sys
from pathlib import Path

import pytest

from gcs_coloc.core.errors import EstimatorError
from gcs_coloc.estimators.qu_zhang.filter import QuZhangFilter
from gcs_coloc.estimators.registry import BUILT_IN, load_estimator, plug_in_digest

PLUG_IN = """
from __future__ import annotations
from dataclasses import dataclass
from typing import Literal
from gcs_coloc.core.measurements import NoEstimate, NoEstimateReason, Unlocated


@dataclass(frozen=True)
class Settings:
    gain: float
    mode: Literal["calm", "eager"] = "calm"
    peers: int | None = None
    on: bool = False
    weights: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.gain < 0:
            raise ValueError("gain is below zero")


class Bare:
    name = "bare"

    def set_denied(self, denied, at_s): ...
    def reset(self, vehicle, at_s): ...
    def add(self, measurement): ...
    def estimate(self, vehicle, at_s): return NoEstimate(vehicle, at_s, Unlocated(NoEstimateReason.OTHER, detail="never"))
    def drain_residuals(self): return []
    def counts(self): return {}


class Mine(Bare):
    name = "mine"

    def __init__(self, settings: Settings) -> None:
        self.settings = settings


class Half:
    name = "half"


class Untyped(Bare):
    def __init__(self, settings) -> None: ...


class Undefined(Bare):
    def __init__(self, settings: Nowhere) -> None: ...
"""


@pytest.fixture
def plug_in(tmp_path: Path) -> str:
    file = tmp_path / "mine.py"
    file.write_text(PLUG_IN)
    return str(file)


@pytest.mark.parametrize("name", sorted(BUILT_IN))
def test_every_built_in_name_loads_and_names_itself(name: str) -> None:
    assert load_estimator(name, {}).name == name


def test_settings_reach_the_estimator_and_an_integer_serves_as_a_float() -> None:
    estimator = load_estimator("qu_zhang", {"max_sigma_m": 50, "covariance": "published"})

    assert isinstance(estimator, QuZhangFilter)
    assert estimator._settings.max_sigma_m == 50.0
    assert isinstance(estimator._settings.max_sigma_m, float)
    assert estimator._settings.covariance == "published"


def test_two_estimators_share_nothing() -> None:
    assert load_estimator("qu_zhang", {}) is not load_estimator("qu_zhang", {})


def test_a_plug_in_file_and_a_plug_in_module(plug_in: str) -> None:
    estimator = load_estimator(f"{plug_in}:Mine", {"gain": 2, "peers": 4, "mode": "eager", "weights": [1, 2.5], "on": True})

    assert estimator.name == "mine"
    assert estimator.settings.gain == 2.0  # type: ignore[attr-defined]
    assert estimator.settings.weights == (1.0, 2.5)  # type: ignore[attr-defined]
    assert load_estimator(f"{plug_in}:Bare", {}).name == "bare"
    assert load_estimator("gcs_coloc.estimators.qu_zhang.filter:QuZhangFilter", {}).name == "qu_zhang"


@pytest.mark.parametrize(
    ("name", "settings", "text"),
    [
        ("kalman", {}, "no estimator is called 'kalman'; there are fleet, qu_zhang"),
        (":Mine", {}, "':Mine' is no estimator: name it as package.module:Class"),
        ("qu_zhang", {"speed": 1}, "no setting 'speed'; it has covariance"),
        ("qu_zhang", {"max_sigma_m": "wide"}, "'max_sigma_m' is 'wide'; it must be of type float"),
        ("qu_zhang", {"max_sigma_m": True}, "must be of type float"),
        ("qu_zhang", {"max_sigma_m": -1.0}, "max_sigma_m must be from 0.01 to 1e+06, not -1"),
        ("no.such.module:Thing", {}, "cannot import estimator module no.such.module"),
        ("no_such_file.py:Thing", {}, "there is no estimator file"),
        ("gcs_coloc.estimators.qu_zhang.filter:Missing", {}, "has no class Missing"),
        ("PLUG:Half", {}, "lacks set_denied, reset, add, estimate"),
        ("PLUG:Bare", {"gain": 1.0}, "has no settings"),
        ("PLUG:Mine", {}, "needs the setting 'gain'"),
        ("PLUG:Mine", {"gain": -1.0}, "gain is below zero"),
        ("PLUG:Mine", {"gain": 1.0, "mode": "wild"}, "'mode' is 'wild'"),
        ("PLUG:Mine", {"gain": 1.0, "weights": [1, "x"]}, "'weights'"),
        ("PLUG:Mine", {"gain": 1.0, "on": 1}, "'on' is 1; it must be of type bool"),
        ("PLUG:Untyped", {}, "annotate its argument settings"),
        ("PLUG:Undefined", {}, "Nowhere"),
    ],
)
def test_what_cannot_be_loaded_is_told_with_its_name(plug_in: str, name: str, settings: dict[str, object], text: str) -> None:
    with pytest.raises(EstimatorError) as told:
        load_estimator(name.replace("PLUG", plug_in), settings)

    assert text in str(told.value)
    assert "\n" not in str(told.value)


def test_a_plug_in_that_fails_on_import_is_told(tmp_path: Path) -> None:
    (tmp_path / "broken.py").write_text("1 / 0\n")

    with pytest.raises(EstimatorError, match="ZeroDivisionError"):
        load_estimator(f"{tmp_path / 'broken.py'}:Any", {})


def test_the_digest_of_a_plug_in_changes_with_its_file_and_with_any_module_of_its_package(
    tmp_path: Path, plug_in: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert plug_in_digest("fleet") == ""
    of_file = plug_in_digest(f"{plug_in}:Mine")
    assert of_file == plug_in_digest(f"{plug_in}:Mine")
    Path(plug_in).write_text(f"{PLUG_IN}# edited")
    assert plug_in_digest(f"{plug_in}:Mine") != of_file
    package = tmp_path / "digested_plug_in"
    package.mkdir()
    for name in ("__init__", "filter", "tools"):
        (package / f"{name}.py").write_text("")
    monkeypatch.syspath_prepend(str(tmp_path))
    of_package = plug_in_digest("digested_plug_in.filter:Mine")
    (package / "tools.py").write_text("WEIGHT = 2\n")
    assert plug_in_digest("digested_plug_in.filter:Mine") != of_package
    assert package.name not in sys.modules
    with pytest.raises(EstimatorError, match="there is no estimator file"):
        plug_in_digest(f"{tmp_path}/none.py:Mine")


def test_an_installed_package_names_its_estimator_by_an_entry_point(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    info = tmp_path / "mine-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[gcs_coloc.estimators]\nmine = package_of_mine:Bare\n")
    (tmp_path / "package_of_mine.py").write_text(PLUG_IN)
    monkeypatch.syspath_prepend(str(tmp_path))

    assert load_estimator("mine", {}).name == "bare"
    with pytest.raises(EstimatorError, match="there are fleet, mine, qu_zhang"):
        load_estimator("other", {})
