"""The registry of estimators: finds the class of a name, and makes its settings from a configuration.

A name is one of `BUILT_IN`, that of an entry point of the group "gcs_coloc.estimators", "package.module:Class", or
"path/to/file.py:Class". The class meets `gcs_coloc.core.estimator.Estimator`. It takes one argument, annotated with its settings
dataclass (or that or None), or no argument if it has no settings.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import inspect
import sys
import types
import typing
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from gcs_coloc.core.errors import EstimatorError
from gcs_coloc.core.estimator import Estimator
from gcs_coloc.runtime.program import source_of

BUILT_IN = {
    "qu_zhang": "gcs_coloc.estimators.qu_zhang.filter:QuZhangFilter",
    "fleet": "gcs_coloc.estimators.fleet.filter:FleetFilter",
}
"""Name of each built-in estimator and its class, which is imported on use."""
GROUP = "gcs_coloc.estimators"
"""The entry-point group by which an installed package names its estimators."""

_MEMBERS = ("name", "set_denied", "reset", "add", "estimate", "drain_residuals", "counts")


def load_estimator(name: str, settings: Mapping[str, Any]) -> Estimator:
    """Return a new estimator.

    Args:
        name: see the module's docstring.
        settings: by field name of the estimator's settings dataclass; fields left out keep their defaults.

    Raises:
        EstimatorError: no such estimator, it cannot be imported, it lacks a member of the protocol, or a setting is unknown,
            missing, of the wrong type or refused. The text names it and the remedy.

    """
    cls = load_class(name)
    lacking = [member for member in _MEMBERS if not hasattr(cls, member)]
    if lacking:
        raise EstimatorError(f"estimator {name!r} lacks {', '.join(lacking)} of the estimator protocol")
    settings_type = settings_type_of(name, cls)
    if settings_type is None and settings:
        raise EstimatorError(f"estimator {name!r} has no settings, but was given {', '.join(sorted(settings))}")
    arguments = [] if settings_type is None else [_make_settings(name, settings_type, settings)]
    try:
        return typing.cast("Estimator", cls(*arguments))
    except Exception as error:  # a plug-in can raise anything
        raise EstimatorError(f"estimator {name!r} cannot be made: {_described(error)}") from error


def load_class(name: str) -> type:
    """Return the class of an estimator by its name.

    Raises:
        EstimatorError: no such estimator, or it cannot be imported.

    """
    where, class_name = _target(name)
    module = _load_file(where) if where.endswith(".py") else _load_module(where)
    cls = getattr(module, class_name, None)
    if not isinstance(cls, type):
        raise EstimatorError(f"{where} has no class {class_name}")
    return cls


def plug_in_digest(name: str) -> str:
    """Return a digest of a plug-in's file, or of the whole package that its module is in.

    It is empty for what is built in.

    With `program_digest` it says whether two results are of the same estimator. Its other packages do not count.

    Raises:
        EstimatorError: no such estimator.

    """
    if name in BUILT_IN:
        return ""
    where, _ = _target(name)
    digest = hashlib.sha256()
    if not where.endswith(".py"):
        for part in source_of(where.partition(".")[0]):
            digest.update(part)
    else:
        try:
            digest.update(_plug_in_file(where).read_bytes())
        except OSError as error:
            raise EstimatorError(f"cannot read estimator file {where}: {error.strerror or error}") from error
    return digest.hexdigest()[:16]


def _target(name: str) -> tuple[str, str]:
    """Return the module or file of an estimator, and the name of its class."""
    target = BUILT_IN.get(name, name)
    if ":" not in target:
        plugins: dict[str, EntryPoint] = {point.name: point for point in entry_points(group=GROUP)}
        if name not in plugins:
            raise EstimatorError(
                f"no estimator is called {name!r}; there are {', '.join(sorted({*BUILT_IN, *plugins}))}, "
                "or name a plug-in as package.module:Class or path/to/file.py:Class"
            )
        target = plugins[name].value
    where, _, class_name = target.rpartition(":")
    if not where or not class_name:
        raise EstimatorError(f"{name!r} is no estimator: name it as package.module:Class or path/to/file.py:Class")
    return where, class_name


def _load_module(module_name: str) -> types.ModuleType:
    try:
        return importlib.import_module(module_name)
    except Exception as error:  # a plug-in's import can raise anything
        raise EstimatorError(f"cannot import estimator module {module_name}: {_described(error)}") from error


def _plug_in_file(path: str) -> Path:
    file = Path(path).expanduser()
    if not file.is_file():
        raise EstimatorError(f"there is no estimator file {path}")
    return file


def _load_file(path: str) -> types.ModuleType:
    file = _plug_in_file(path)
    # The full path as the module's name: two files of one name do not meet, and nothing installed is hidden.
    spec = importlib.util.spec_from_file_location(str(file.resolve()), file)
    if spec is None or spec.loader is None:
        raise EstimatorError(f"cannot import estimator file {path}")
    module = importlib.util.module_from_spec(spec)
    # Dataclasses look their own module up while they are made.
    sys.modules[spec.name] = module
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # a plug-in's import can raise anything
        del sys.modules[spec.name]
        raise EstimatorError(f"cannot import estimator file {path}: {_described(error)}") from error
    return module


def settings_type_of(name: str, cls: type) -> type | None:
    """Return the settings dataclass of a class's first argument, None where it has no argument."""
    try:
        parameters = list(inspect.signature(cls, eval_str=True).parameters.values())
    except NameError as error:
        raise EstimatorError(f"estimator {name!r}: the type of its settings cannot be found: {error}") from error
    if not parameters:
        return None
    hint = parameters[0].annotation
    for one in (hint, *typing.get_args(hint)):
        if isinstance(one, type) and is_dataclass(one):
            return one
    raise EstimatorError(f"estimator {name!r}: annotate its argument {parameters[0].name} with a settings dataclass")


def _make_settings(name: str, settings_type: type, settings: Mapping[str, Any]) -> object:
    known = {one.name: one for one in fields(settings_type) if one.init}
    renamed: Mapping[str, str] = getattr(settings_type, "RENAMED", {})
    for key in settings:
        if key in renamed:
            raise EstimatorError(f"estimator {name!r}: the setting {key!r} is called {renamed[key]!r} now")
        if key not in known:
            raise EstimatorError(f"estimator {name!r} has no setting {key!r}; it has {', '.join(known)}")
    for key, one in known.items():
        if key not in settings and one.default is MISSING and one.default_factory is MISSING:
            raise EstimatorError(f"estimator {name!r} needs the setting {key!r}")
    hints = typing.get_type_hints(settings_type)
    values = {key: _checked(name, key, value, hints[key]) for key, value in settings.items()}
    try:
        return settings_type(**values)
    except EstimatorError:
        raise
    except (TypeError, ValueError) as error:
        raise EstimatorError(f"estimator {name!r} refuses its settings: {error}") from error


def _checked(name: str, key: str, value: object, hint: object) -> object:
    """Return the value as its field has it, an integer as a float where one is meant."""
    fitting = _fitted(value, hint)
    if fitting is _NOTHING:
        expected = getattr(hint, "__name__", None) if isinstance(hint, type) else str(hint)
        raise EstimatorError(f"estimator {name!r}: setting {key!r} is {value!r}; it must be of type {expected}")
    return fitting


_NOTHING = object()


def _fitted(value: object, hint: object) -> object:
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if hint is Any:
        return value
    if origin in (typing.Union, types.UnionType):
        return next((fit for fit in (_fitted(value, one) for one in arguments) if fit is not _NOTHING), _NOTHING)
    if origin is typing.Literal:
        return value if value in arguments else _NOTHING
    if origin is tuple and isinstance(value, (list, tuple)):
        inner = arguments[:1] * len(value) if arguments[1:] == (...,) else arguments
        fits = [_fitted(one, kind) for one, kind in zip(value, inner, strict=False)]
        return tuple(fits) if len(inner) == len(value) and _NOTHING not in fits else _NOTHING
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    kind = origin or hint
    if not isinstance(kind, type) or not isinstance(value, kind):
        return _NOTHING
    # In Python a bool is an int; in a configuration it is not.
    return value if not isinstance(value, bool) or kind is bool else _NOTHING


def _described(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"
