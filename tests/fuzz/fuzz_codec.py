"""`python tests/fuzz/fuzz_codec.py -atheris_runs=N`: the fuzz target under atheris, guided by coverage. See `make fuzz`."""

import sys
from pathlib import Path

import atheris

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

with atheris.instrument_imports(include=["gcs_coloc", "fuzz_target"]):
    import fuzz_target

atheris.Setup(sys.argv, fuzz_target.run)
atheris.Fuzz()
