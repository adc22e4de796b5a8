"""The command line in this process: what `gcs-coloc` prints and returns, without the seconds that a start of Python takes."""

from __future__ import annotations

import contextlib
import io
import sys
from subprocess import CompletedProcess
from unittest.mock import patch

from gcs_coloc.cli.main import main


def gcs_coloc(*arguments: object) -> CompletedProcess[str]:
    """Run the entry point with these arguments. Not for what needs a process: signals, descriptors, a service that runs."""
    command = ["gcs-coloc", *map(str, arguments)]
    out, err, status = io.StringIO(), io.StringIO(), 0
    with patch.object(sys, "argv", command), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main()
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else 1
    return CompletedProcess(command, status, out.getvalue(), err.getvalue())
