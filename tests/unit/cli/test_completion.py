"""Shell completion: Typer's own, with the commands that are imported late."""

from __future__ import annotations

import os
from unittest.mock import patch

import pytest
from command_line import gcs_coloc


def completed(**variables: str) -> str:
    # The name of the variables goes by that of the program.
    with patch.dict(os.environ, variables):
        run = gcs_coloc()
    assert run.stderr == ""
    return run.stdout


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_for_a_shell_is_written(shell):
    script = completed(_GCS_COLOC_COMPLETE=f"source_{shell}")
    assert "_GCS_COLOC_COMPLETE=" in script
    assert "gcs-coloc" in script


def test_commands_and_options_are_completed():
    asked = {"_GCS_COLOC_COMPLETE": "complete_bash", "COMP_CWORD": "1"}
    assert completed(**asked, COMP_WORDS="gcs-coloc ev").split() == ["evaluate"]
    assert completed(**asked, COMP_WORDS="gcs-coloc --no").split() == ["--no-web"]
