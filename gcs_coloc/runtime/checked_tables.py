"""Tables of TOML and JSON files, checked: an error names the file, its place and what was expected."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import ErrorDetails

from gcs_coloc.core.errors import DataError, GcsColocError
from gcs_coloc.runtime.files import reading

_QUOTE = "'"  # around the names in pydantic's errors
_MOST_SHOWN = 60  # characters of a wrong value; chosen: the line stays one

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
"""A finite number; neither a truth value nor the text of a number is one."""


_WORDS = {
    "missing": "is missing",
    "extra_forbidden": "unknown key; see the reference of this file for those there are",
    "tuple_type": "should be a list; of tables it is written [[name]] in TOML",
    "list_type": "should be a list; of tables it is written [[name]] in TOML",
    "model_type": "should be a table",
    "model_attributes_type": "should be a table",
}
"""Of pydantic's kinds of errors, those whose own words name its classes or say less."""


class Table(BaseModel):
    """A table of which every key is known."""

    model_config = ConfigDict(extra="forbid", frozen=True)


Checked = TypeVar("Checked", bound=BaseModel)


def read_toml(path: Path, error: type[GcsColocError] = DataError) -> dict[str, Any]:
    """Return the table in a TOML file.

    `error` is raised where it cannot be read or is none; its text names the file.
    """
    with reading(path, error):
        text = path.read_text(encoding="utf-8-sig")  # Windows' editors begin a file with a byte order mark
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as found:
        raise error(f"{path}: is not valid TOML: {found}") from None
    except (ValueError, RecursionError):  # Python converts no integer of thousands of digits
        raise error(f"{path}: is not valid TOML: a number is too long, or tables are nested too deep") from None


def checked(model: type[Checked], content: Mapping[str, Any] | str, where: str) -> Checked:
    """Return a table as a model: the table itself, or JSON text.

    Raises:
        DataError: a key is missing or unknown, or a value impossible; the text begins with `where`.
    """
    try:
        return model.model_validate_json(content) if isinstance(content, str) else model.model_validate(content)
    except ValidationError as error:
        found = error.errors(include_url=False)[0]
        place = ""
        for part in found["loc"]:
            place += f" {part + 1}" if isinstance(part, int) else f": {part}"
        raise DataError(f"{where}{place}{_problem(found)}") from None


def _problem(found: ErrorDetails) -> str:
    """Return what is wrong at a place, in words."""
    kind, text = found["type"], found["msg"].removeprefix("Value error, ").removeprefix("Input ")
    if kind in _WORDS:
        return f": {_WORDS[kind]}"
    if kind.startswith("union_tag"):
        about = found["ctx"]
        text = f"should be one of {about['expected_tags']}, not {about['tag']!r}" if "tag" in about else "is missing"
        return f": {about['discriminator'].strip(_QUOTE)}: {text}"
    told = "" if kind in ("json_invalid", "value_error") else f", not {_shown(found['input'])}"
    return f": {text}{told}"


def _shown(value: object) -> str:
    """Return a value of a file in one line that can be read."""
    try:
        text = repr(value)
    except ValueError:  # an integer of thousands of digits
        text = "a number of thousands of digits"
    return text if len(text) <= _MOST_SHOWN else f"{text[:_MOST_SHOWN]}..."
