"""Kept results of tasks, a file for each in a directory, so that a run that was stopped goes on where it was."""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable
from pathlib import Path

from gcs_coloc.core.errors import UsageError
from gcs_coloc.runtime.output_paths import make_output_directory
from gcs_coloc.runtime.program import program_versions


class KeptResults:
    """Results by what was computed: program, function and task. Another program or task finds nothing of these."""

    def __init__(self, directory: Path) -> None:
        """Make the directory where there is none.

        Raises:
            UsageError: it is a file, or may not be made.
        """
        make_output_directory(directory, "--resume")
        self._directory = directory

    def path_of(self, function: Callable[..., object], task: object) -> Path:
        """Return the file of a task's result; it exists where the task was done."""
        digest = hashlib.sha256(pickle.dumps((program_versions(), function, task)))
        return self._directory / f"{digest.hexdigest()[:32]}.pickle"

    def load(self, path: Path) -> object:
        """Return a result.

        Raises:
            UsageError: it cannot be read.
        """
        try:
            result: object = pickle.loads(path.read_bytes())  # noqa: S301 - as much the user's own as the program is
        except (OSError, pickle.UnpicklingError, EOFError) as error:
            raise UsageError(f"--resume {self._directory}: {path.name} cannot be read ({error}); delete it") from None
        return result

    def store(self, path: Path, result: object) -> None:
        """Write a result: whole, or, where the program is stopped meanwhile, not at all.

        Raises:
            UsageError: it cannot be written.
        """
        draft = path.with_suffix(".part")
        try:
            draft.write_bytes(pickle.dumps(result))
            draft.replace(path)
        except OSError as error:
            raise UsageError(f"--resume {self._directory}: cannot be written to: {error.strerror}") from None
