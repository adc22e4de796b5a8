"""The digest of the program: whatever a result may depend on is in it."""

import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest

from gcs_coloc.runtime import program
from gcs_coloc.runtime.program import program_digest

ROOT = Path(__file__).resolve().parents[3]


@pytest.mark.parametrize("edited", ["gcs_coloc/core/engine.py", "sitl_fakes/guidance.py", "sitl_fakes/scenarios/paper.toml"])
def test_the_digest_changes_with_the_service_the_simulated_aircraft_and_their_scenarios(tmp_path, monkeypatch, edited):
    for package in ("gcs_coloc", "sitl_fakes"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__", "static"))

    def found(name):
        return SimpleNamespace(submodule_search_locations=[str(tmp_path / name)], origin=None)

    monkeypatch.setattr(program, "find_spec", found)
    before = program_digest.__wrapped__()
    assert program_digest.__wrapped__() == before
    (tmp_path / edited).write_text(f"{(tmp_path / edited).read_text()}\n# edited\n")
    assert program_digest.__wrapped__() != before
