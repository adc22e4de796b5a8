"""What containers and systemd are configured by holds together with the program, as far as that shows without an engine."""

import ast
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

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


def test_the_template_is_the_unit_but_for_the_name_of_the_instance():
    unit, template = (
        [line for line in (ROOT / "configs" / name).read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
        for name in ("gcs-coloc.service", "gcs-coloc@.service")
    )
    different = [(own, other) for own, other in zip(unit, template, strict=True) if own != other]
    assert [own.partition("=")[0] for own, _ in different] == ["Description", "ExecStart", "StateDirectory"]
    assert all("%i" in other for _, other in different)


def test_the_compose_file_of_two_hosts_shares_nothing_but_the_bridge():
    text = (ROOT / "compose.two-hosts.yaml").read_text(encoding="utf-8")
    services = yaml.safe_load(text)["services"]
    of_host = {name: set(service.get("networks", ())) for name, service in services.items()}
    assert {name for name, networks in of_host.items() if "between" in networks} == {"broker-a", "broker-b"}
    assert not [name for name, networks in of_host.items() if {"host-a", "host-b"} <= networks]
    variables = {*re.findall(r"\$\{(\w+):-", text), *re.findall(r"args: \[(\w+)\]", text)}
    told = PAGE + (ROOT / "docs/how-to/watch-many-fleets.md").read_text(encoding="utf-8")
    assert [variable for variable in sorted(variables) if f"`{variable}`" not in told] == []


@pytest.mark.parametrize("name", ["gcs-coloc.service", "gcs-coloc@.service", "gcs-coloc-watch.service"])
def test_the_unit_is_one_that_systemd_takes(tmp_path, name):
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not installed")
    unit = tmp_path / name.replace("@", "@north")
    text = (ROOT / "configs" / name).read_text(encoding="utf-8")
    unit.write_text(text.replace("/opt/gcs-coloc/bin/gcs-coloc", sys.executable))  # systemd wants a program that exists
    checked = subprocess.run(["systemd-analyze", "verify", unit], capture_output=True, text=True)
    assert (checked.returncode, checked.stderr) == (0, "")
