"""What containers and systemd are configured by holds together with the program, as far as that shows without an engine."""

import ast
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from gcs_coloc import __version__
from gcs_coloc.config.fleets import load_settings

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/how-to/deploy.md").read_text(encoding="utf-8")


def test_the_image_carries_the_programs_version():
    assert f'org.opencontainers.image.version="{__version__}"' in (ROOT / "Dockerfile").read_text(encoding="utf-8")


def test_the_image_keeps_every_dialect_that_is_imported():
    kept = set(re.findall(r"! -name '(\w+)\.\*'", (ROOT / "Dockerfile").read_text(encoding="utf-8"))) - {"__init__"}
    sources = [file for package in ("gcs_coloc", "sitl_fakes") for file in (ROOT / package).rglob("*.py")]
    trees = [ast.parse(file.read_text(encoding="utf-8")) for file in sources]
    imports = [node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    whole = {name.name for i in imports if i.module == "pymavlink.dialects.v20" for name in i.names}
    parts = {i.module.rpartition(".")[2] for i in imports if (i.module or "").startswith("pymavlink.dialects.v20.")}
    assert whole | parts == kept


@pytest.mark.parametrize("directory", ["demo", "field"])
def test_the_containers_configurations_are_good_and_serve_the_page_where_the_health_check_asks(directory):
    settings = load_settings(ROOT / "configs" / directory / "gcs-coloc.toml", {})
    assert settings.web.host_and_port()[1] == 8080
    assert settings.record.directory == "/var/lib/gcs-coloc/recordings"


def test_every_variable_of_compose_is_on_the_page():
    compose = (ROOT / "compose.yaml").read_text(encoding="utf-8")
    variables = {*re.findall(r"\$\{(\w+):-", compose), *re.findall(r"args: \[(\w+)\]", compose)}
    assert len(variables) == 5
    for variable in variables:
        assert f"| `{variable}` |" in PAGE, variable


def test_the_unit_is_one_that_systemd_takes(tmp_path):
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not installed")
    unit = tmp_path / "gcs-coloc.service"
    text = (ROOT / "configs/gcs-coloc.service").read_text(encoding="utf-8")
    unit.write_text(text.replace("/opt/gcs-coloc/bin/gcs-coloc", sys.executable))  # systemd wants a program that exists
    checked = subprocess.run(["systemd-analyze", "verify", unit], capture_output=True, text=True)
    assert (checked.returncode, checked.stderr) == (0, "")
