"""One word for one thing: the names of the package are the field's, each class name stands once."""

import ast
import re
from collections import defaultdict
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "gcs_coloc"
GLOSSARY = ROOT / "docs/glossary.md"
MODULES = sorted(path for path in PACKAGE.rglob("*.py") if "_generated" not in path.parts)
OTHERS = sorted(
    path for folder in ("bench", "examples", "sitl_fakes", "tests", "tools") for path in (ROOT / folder).rglob("*.py")
)
PRIVATE_WORDS = frozenset(
    [
        "accused",
        "acquit",
        "acquits",
        "acquitted",
        "captive",
        "captives",
        "claim",
        "claims",
        "distrusts",
        "doubt",
        "doubted",
        "faded",
        "fear",
        "feared",
        "fears",
        "foresee",
        "foreseen",
        "foresees",
        "glance",
        "glances",
        "hindrance",
        "hindrances",
        "hub",
        "hubs",
        "intake",
        "intakes",
        "jolt",
        "jolted",
        "jolts",
        "liar",
        "liars",
        "lie",
        "lies",
        "lookout",
        "lookouts",
        "lull",
        "lulls",
        "mend",
        "mended",
        "mends",
        "misfit",
        "misfits",
        "misplaced",
        "news",
        "obey",
        "obeyed",
        "obeys",
        "remark",
        "retell",
        "scene",
        "scenes",
        "stories",
        "story",
        "subject",
        "subjects",
        "tale",
        "tales",
        "thaw",
        "thawed",
        "thaws",
        "tidied",
        "tidy",
        "twin",
        "twins",
        "uptake",
        "uptakes",
        "verdict",
        "verdicts",
        "withheld",
        "withholds",
    ]
)
"""Words that version 0.1 used for things that have a name in the field; docs/glossary.md has that."""

VAGUE_VERBS = frozenset(["ask", "begin", "distrust", "give", "look", "say", "settle", "settled", "take", "tell"])
"""As the whole name of a function they leave open what it does: request, initialise, publish, drain, ... say it."""
OTHERS_VERBS = {
    "gcs_coloc/core/integrity/reacquisition.py": {"_begin"},
    "gcs_coloc/recorder/formats/mcap_file.py": {"tell"},
}
"""What a file of Python has to be called, and two private functions that are still to be renamed."""

FIRST_LINE_CHARACTERS = 100
_DEFINITIONS = ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


def relative(path: Path) -> str:
    return str(path.relative_to(ROOT))


def words(name: str) -> set[str]:
    """The words of an identifier or of a text, in lower case: FaultMonitor, fault_monitor and "fault monitor" are alike."""
    return {word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)}


def terms() -> list[str]:
    rows = [line.split("|")[1].strip() for line in GLOSSARY.read_text(encoding="utf-8").splitlines() if line.startswith("| ")]
    return [term for term in rows if term != "term"]


def plain(text: str) -> str:
    return re.sub(r"[\s_-]+", " ", text).lower()


def stems(name: str) -> set[str]:
    """The words of a name without their endings, so that filters, filtered and filter are one."""
    return {re.sub(r"(ings?|ed|ers?|ors?|es|s|e|y|ies)$", "", word) or word for word in words(name)}


class Contents(NamedTuple):
    """What a module defines: every name, its functions, its public classes, and what its docstrings begin with."""

    names: set[str]
    """Itself, its classes and functions, their arguments and attributes, its constants."""
    functions: set[str]
    public_classes: list[str]
    long_first_lines: list[str]
    is_named_after_them: bool
    """Whether a word of the module's name is in the first line of its docstring or in the name of its largest definition."""


@cache
def contents(path: Path) -> Contents:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    names, functions, first_lines = {path.stem}, set(), []
    for node in ast.walk(tree):
        if isinstance(node, _DEFINITIONS):
            names.add(node.name)
            if not isinstance(node, ast.ClassDef):
                functions.add(node.name)
        elif isinstance(node, ast.arg):
            names.add(node.arg)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            names.add(node.attr)
        if isinstance(node, ast.Module | _DEFINITIONS):
            first_lines.append((ast.get_docstring(node) or " ").splitlines()[0])
    definitions = [node for node in tree.body if isinstance(node, _DEFINITIONS)]
    largest = max(definitions, key=lambda node: (node.end_lineno or 0) - node.lineno, default=None)
    told = stems(first_lines[0]) | (stems(largest.name) if largest is not None else set())
    return Contents(
        names,
        functions,
        [node.name for node in definitions if isinstance(node, ast.ClassDef) and not node.name.startswith("_")],
        [line for line in first_lines if len(line) > FIRST_LINE_CHARACTERS],
        bool(stems(path.stem) & told),
    )


def test_every_term_of_the_glossary_is_used():
    pages = [path for path in ROOT.glob("docs/**/*.md") if path != GLOSSARY]
    text = plain("\n".join(path.read_text(encoding="utf-8") for path in [*MODULES, *pages]))
    assert len(terms()) >= 60
    assert [term for term in terms() if plain(term) not in text] == []


def test_no_term_stands_twice_in_the_glossary():
    assert len({plain(term) for term in terms()}) == len(terms())


def test_no_public_class_name_stands_twice():
    places = defaultdict(list)
    for path in MODULES:
        for name in contents(path).public_classes:
            places[name].append(relative(path))
    assert {name: paths for name, paths in places.items() if len(paths) > 1} == {}


def test_no_name_is_a_private_word():
    found = {relative(path): {n for n in contents(path).names if words(n) & PRIVATE_WORDS} for path in MODULES + OTHERS}
    assert {path: names for path, names in found.items() if names} == {}


def test_no_function_is_named_by_a_vague_verb_alone():
    checked = [path for path in MODULES + OTHERS if not relative(path).startswith("tests")]
    found = {relative(path): {n for n in contents(path).functions if n.strip("_") in VAGUE_VERBS} for path in checked}
    assert {path: names for path, names in found.items() if names} == OTHERS_VERBS


def test_a_docstring_says_in_its_first_line_what_the_thing_is():
    found = {relative(path): contents(path).long_first_lines for path in MODULES if contents(path).long_first_lines}
    assert not found, "a docstring's first line says what the thing is, in 100 characters; reasons come below it"


def test_a_module_is_named_after_its_main_content():
    found = [relative(p) for p in MODULES if not p.name.startswith("__") and not contents(p).is_named_after_them]
    assert found == [], "their docstring's first line has no word of their name, their largest definition neither"
