"""gcs-coloc: locates MAVLink vehicles whose GPS has failed from their ranges to neighbours.

As a library: filters, measurements, evaluation and the engine are importable from here, and are loaded on first use.

    from gcs_coloc import FleetFilter, PositionMeasurement, RangeMeasurement

    estimator = FleetFilter()
    estimator.add(PositionMeasurement(vehicle=1, measured_at_s=0.0, arrived_at_s=0.0, ...))
    estimator.set_denied({4}, at_s=0.0)
    estimator.add(RangeMeasurement(from_vehicle=4, to_vehicle=1, measured_at_s=0.0, arrived_at_s=0.0, range_m=80.0, sigma_m=0.1))
    print(estimator.estimate(vehicle=4, at_s=0.0))

The scripts in `examples/` show each use in full.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gcs_coloc.core.engine import Engine, EngineSettings
    from gcs_coloc.core.errors import ConfigError, DataError, EstimatorError, GcsColocError
    from gcs_coloc.core.estimator import Estimator
    from gcs_coloc.core.measurements import (
        AltitudeMeasurement,
        AttitudeMeasurement,
        Estimate,
        Measurement,
        NoEstimate,
        NoEstimateReason,
        OdometryMeasurement,
        PositionMeasurement,
        RangeMeasurement,
        Residual,
        Unlocated,
    )
    from gcs_coloc.estimators.fleet.filter import FleetFilter
    from gcs_coloc.estimators.fleet.settings import FleetSettings
    from gcs_coloc.estimators.qu_zhang.filter import QuZhangFilter
    from gcs_coloc.estimators.qu_zhang.settings import QuZhangSettings
    from gcs_coloc.estimators.registry import load_estimator
    from gcs_coloc.evaluation.dataset import Dataset, read_dataset
    from gcs_coloc.evaluation.evaluate import Evaluation, evaluate, evaluate_dataset
    from gcs_coloc.evaluation.output import plot_evaluation, write_epochs
    from gcs_coloc.recorder.flight_history import RecordingArrays, VehicleArrays, read_recording

__version__ = "0.2.0"

__all__ = [
    "AltitudeMeasurement",
    "AttitudeMeasurement",
    "ConfigError",
    "DataError",
    "Dataset",
    "Engine",
    "EngineSettings",
    "Estimate",
    "Estimator",
    "EstimatorError",
    "Evaluation",
    "FleetFilter",
    "FleetSettings",
    "GcsColocError",
    "Measurement",
    "NoEstimate",
    "NoEstimateReason",
    "OdometryMeasurement",
    "PositionMeasurement",
    "QuZhangFilter",
    "QuZhangSettings",
    "RangeMeasurement",
    "RecordingArrays",
    "Residual",
    "Unlocated",
    "VehicleArrays",
    "__version__",
    "evaluate",
    "evaluate_dataset",
    "load_estimator",
    "plot_evaluation",
    "read_dataset",
    "read_recording",
    "write_epochs",
]

_MODULE_OF = {
    "AltitudeMeasurement": "core.measurements",
    "AttitudeMeasurement": "core.measurements",
    "GcsColocError": "core.errors",
    "ConfigError": "core.errors",
    "DataError": "core.errors",
    "Dataset": "evaluation.dataset",
    "Engine": "core.engine",
    "EngineSettings": "core.engine",
    "Estimate": "core.measurements",
    "Estimator": "core.estimator",
    "EstimatorError": "core.errors",
    "Evaluation": "evaluation.evaluate",
    "FleetFilter": "estimators.fleet.filter",
    "FleetSettings": "estimators.fleet.settings",
    "Measurement": "core.measurements",
    "NoEstimate": "core.measurements",
    "NoEstimateReason": "core.measurements",
    "OdometryMeasurement": "core.measurements",
    "PositionMeasurement": "core.measurements",
    "QuZhangFilter": "estimators.qu_zhang.filter",
    "QuZhangSettings": "estimators.qu_zhang.settings",
    "RangeMeasurement": "core.measurements",
    "RecordingArrays": "recorder.flight_history",
    "Residual": "core.measurements",
    "Unlocated": "core.measurements",
    "VehicleArrays": "recorder.flight_history",
    "evaluate": "evaluation.evaluate",
    "evaluate_dataset": "evaluation.evaluate",
    "load_estimator": "estimators.registry",
    "plot_evaluation": "evaluation.output",
    "read_dataset": "evaluation.dataset",
    "read_recording": "recorder.flight_history",
    "write_epochs": "evaluation.output",
}
"""Where each public name is; imported on first use (PEP 562), so that the command line does not load what it does not need."""


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
