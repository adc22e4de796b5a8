"""Writes the tables of settings in the reference pages from the settings' own classes: `make reference`."""

from __future__ import annotations

import ast
import inspect
import math
import re
import sys
import textwrap
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, cast

from pydantic import BaseModel

from gcs_coloc.config.sections import StationConfig
from gcs_coloc.config.settings import Settings
from gcs_coloc.core.setting_bounds import Bounds, field_bounds
from gcs_coloc.estimators.registry import load_class, settings_type_of

ROOT = Path(__file__).resolve().parents[1]
PAGES = tuple(ROOT / f"docs/reference/{page}.md" for page in ("configuration", "estimator-fleet", "estimator-qu-zhang"))
_TABLE = re.compile(r"(<!-- settings: (\w+) -->\n).*?(<!-- end of settings -->)", re.DOTALL)
_TOP_LEVEL = "top_level"
OF_EACH: dict[str, type] = {"station": StationConfig}
"""Tables of which there may be several, `[[name]]`, and the settings of each."""
REQUIRED = object()
_ESTIMATOR = "estimator_"
"""Before the name of an estimator whose settings the table holds."""


def _field_docstrings(settings_type: type) -> dict[str, str]:
    """Return the docstring under each field of a dataclass, on one line."""
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(settings_type))).body
    found: dict[str, str] = {}
    key = None
    for node in cast("ast.ClassDef", definition).body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            key = node.target.id
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str) and key:
            found[key] = " ".join(node.value.value.split())
            key = None
    return found


def field_texts(cls: type) -> dict[str, str]:
    """The string literal under each field of a class and of its bases, as one line."""
    texts: dict[str, str] = {}
    for base in reversed(cls.__mro__):
        if not base.__module__.startswith("gcs_coloc."):
            continue
        texts |= _field_docstrings(base)
    return texts


def table(cls: type) -> str:
    """The Markdown table of one class of settings: key, default, bounds, meaning."""
    texts = field_texts(cls)
    lines = ["| key | default | bounds | meaning |", "|---|---|---|---|"]
    for name, default, bounds in _model_rows(cls) if issubclass(cls, BaseModel) else _dataclass_rows(cls):
        lines.append(f"| `{name}` | {_shown(default)} | {bounds} | {texts[name].replace('|', chr(92) + '|')} |")
    return "\n".join(lines) + "\n"


def written(page: str) -> str:
    """A page with each of its tables made anew."""
    return _TABLE.sub(lambda found: found[1] + "\n" + table(_section(found[2])) + "\n" + found[3], page)


def _section(name: str) -> type:
    if name.startswith(_ESTIMATOR):
        estimator = name.removeprefix(_ESTIMATOR)
        return cast("type", settings_type_of(estimator, load_class(estimator)))
    if name in OF_EACH:
        return OF_EACH[name]
    return Settings if name == _TOP_LEVEL else type(getattr(Settings(), name))


def _model_rows(cls: type[BaseModel]) -> list[tuple[str, Any, str]]:
    sections = Settings.model_fields if cls is Settings else {}
    rows = []
    for name, one in cls.model_fields.items():
        if name in sections and name not in ("links", "out"):
            continue
        # The rules are classes of annotated-types, each with its bound under one of these names.
        told = {word: getattr(rule, word) for rule in one.metadata for word in ("ge", "gt", "le") if hasattr(rule, word)}
        least = told.get("ge", told.get("gt", -math.inf))
        bounds = Bounds(least, told.get("le", math.inf), open_below="gt" in told) if told else ""
        rows.append((name, REQUIRED if one.is_required() else one.get_default(call_default_factory=True), str(bounds)))
    return rows


def _dataclass_rows(cls: Any) -> list[tuple[str, Any, str]]:
    def default(one: Any) -> Any:
        return one.default if one.default is not MISSING else one.default_factory()

    return [(one.name, default(one), str(field_bounds(one) or "")) for one in fields(cls)]


def _shown(value: Any) -> str:
    if value is REQUIRED:
        return "required"
    if isinstance(value, bool):
        return str(value).lower()
    return f"`{value}`" if isinstance(value, str) and value else (str(value) if isinstance(value, int | float) else "none")


def main() -> None:
    """Write the pages."""
    for page in PAGES:
        page.write_text(written(page.read_text(encoding="utf-8")), encoding="utf-8")
        print(page.relative_to(ROOT), file=sys.stderr)


if __name__ == "__main__":
    main()
