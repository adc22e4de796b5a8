"""The documentation is complete, its links and paths lead somewhere, and it reads plainly.

`make docs` checks the links and anchors of the site; here are those of the files outside it, and what the site cannot know.
"""

import re
from pathlib import Path

import typer

from gcs_coloc.cli.main import app

ROOT = Path(__file__).resolve().parents[2]
COMMANDS = (ROOT / "docs/reference/command-line.md").read_text(encoding="utf-8")
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
EXPLANATIONS = sorted(ROOT.glob("docs/explanation/*.md"))
LINE_LIMIT = 130
"""Columns, as in the code. A row of a table cannot be broken."""
EXPLANATION_LIMIT = 1500
"""Words of an explanation page: what one reads at one sitting. Chosen; tables of results have pages of their own."""


def relative(path: Path) -> str:
    return str(path.relative_to(ROOT))


def options(command) -> list[str]:
    return [name for p in command.params for name in p.opts if name.startswith("--")]


def all_commands(command, path="gcs-coloc"):
    yield path, command
    for name in command.list_commands(None) if hasattr(command, "list_commands") else ():
        yield from all_commands(command.get_command(None, name), f"{path} {name}")


def test_every_command_and_option_is_in_the_reference():
    for path, command in all_commands(typer.main.get_command(app)):
        heading = COMMANDS.find(f"## `{path}")
        assert heading >= 0, f"{path} is not in command-line.md"
        section = COMMANDS[heading : COMMANDS.find("\n## ", heading + 1)]
        for option in options(command):
            assert f"`{option}" in section, f"{option} of {path} is not in command-line.md"


def test_every_link_of_a_page_outside_the_site_leads_to_a_file():
    for page in ROOT.glob("*.md"):
        for target in re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8")):
            if "://" not in target:
                assert (page.parent / target).exists(), f"{relative(page)}: {target} does not exist"


def test_every_path_named_on_a_page_exists():
    rooms = "|".join(path.name for path in (ROOT / "gcs_coloc").iterdir() if path.is_dir())
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for path in re.findall(r"`((?:gcs_coloc|sitl_fakes|tests|bench|tools|configs|docs|examples)/[\w./-]*)`", text):
            assert (ROOT / path).exists(), f"{relative(page)}: {path} does not exist"
        for path in re.findall(rf"`((?:{rooms})/[\w./-]*)`", text):
            exists = (ROOT / "gcs_coloc" / path).exists() or (ROOT / path).exists()
            assert exists, f"{relative(page)}: gcs_coloc/{path} does not exist"


def test_no_line_is_too_long():
    for page in PAGES:
        lines = enumerate(page.read_text(encoding="utf-8").splitlines(), 1)
        too_long = [number for number, line in lines if len(line) > LINE_LIMIT and not line.lstrip().startswith("|")]
        assert too_long == [], relative(page)


def test_fractions_have_braces():
    """The site's converter reads a fraction of two digits without them as twelve over what follows."""
    assert [relative(page) for page in PAGES if re.search(r"frac\d", page.read_text(encoding="utf-8"))] == []


def test_an_explanation_is_read_at_one_sitting():
    words = {relative(page): len(page.read_text(encoding="utf-8").split()) for page in EXPLANATIONS}
    assert {page: count for page, count in words.items() if count >= EXPLANATION_LIMIT} == {}


def test_results_name_date_commit_and_command():
    for page in ROOT.glob("docs/results/*.md"):
        text = page.read_text(encoding="utf-8")
        assert re.search(r"20\d\d-\d\d-\d\d, commits? [0-9a-f]{7}", text), relative(page)
        assert re.search(r"`(python -m bench|gcs-coloc) ", text), relative(page)


def test_the_architecture_page_names_every_room():
    text = (ROOT / "docs/explanation/architecture.md").read_text(encoding="utf-8")
    rooms = [path.name for path in (ROOT / "gcs_coloc").iterdir() if path.is_dir() and path.name != "__pycache__"]
    stages = [path.name for path in (ROOT / "gcs_coloc/core").iterdir() if path.is_dir() and path.name != "__pycache__"]
    assert [room for room in rooms if f"\n      {room}/" not in text] == []
    assert [stage for stage in stages if f"\n        {stage}/" not in text] == []
