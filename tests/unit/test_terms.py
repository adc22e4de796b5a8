"""One word for one thing: the names of the package are the field's, each class name stands once."""

import ast
import re
from collections import defaultdict
from pathlib import Path

import pytest

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


def public_classes() -> dict[str, list[str]]:
    found = defaultdict(list)
    for path in MODULES:
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                found[node.name].append(relative(path))
    return found


def names_of(path: Path) -> set[str]:
    """Every name that a module defines: itself, its classes and functions, their arguments and attributes, its constants."""
    found = {path.stem}
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            found.add(node.name)
        elif isinstance(node, ast.arg):
            found.add(node.arg)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            found.add(node.id)
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            found.add(node.attr)
    return found


def test_every_term_of_the_glossary_is_used():
    pages = [path for path in ROOT.glob("docs/**/*.md") if path != GLOSSARY]
    text = plain("\n".join(path.read_text(encoding="utf-8") for path in [*MODULES, *pages]))
    assert len(terms()) >= 60
    assert [term for term in terms() if plain(term) not in text] == []


def test_no_term_stands_twice_in_the_glossary():
    assert len({plain(term) for term in terms()}) == len(terms())


def test_no_public_class_name_stands_twice():
    assert {name: places for name, places in public_classes().items() if len(places) > 1} == {}


@pytest.mark.parametrize("path", MODULES + OTHERS, ids=relative)
def test_no_name_is_a_private_word(path):
    assert {name for name in names_of(path) if words(name) & PRIVATE_WORDS} == set()


@pytest.mark.parametrize("path", [path for path in MODULES + OTHERS if not relative(path).startswith("tests")], ids=relative)
def test_no_function_is_named_by_a_vague_verb_alone(path):
    nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    names = {node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)}
    assert {name for name in names if name.strip("_") in VAGUE_VERBS} == OTHERS_VERBS.get(relative(path), set())


def stems(name: str) -> set[str]:
    """The words of a name without their endings, so that filters, filtered and filter are one."""
    return {re.sub(r"(ings?|ed|ers?|ors?|es|s|e|y|ies)$", "", word) or word for word in words(name)}


def is_named_after_its_content(path: Path) -> bool:
    """Whether a word of the module's name is in the first line of its docstring or in the name of its largest definition."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    definitions = [node for node in tree.body if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)]
    largest = max(definitions, key=lambda node: (node.end_lineno or 0) - node.lineno, default=None)
    first_line = (ast.get_docstring(tree) or "").splitlines()[0]
    return bool(stems(path.stem) & (stems(first_line) | (stems(largest.name) if largest is not None else set())))


def long_first_lines(path: Path) -> list[str]:
    documented = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
    nodes = [node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, documented)]
    first_lines = [(ast.get_docstring(node) or " ").splitlines()[0] for node in nodes]
    return [line for line in first_lines if len(line) > FIRST_LINE_CHARACTERS]


def test_a_docstring_says_in_its_first_line_what_the_thing_is():
    found = {relative(path): lines for path in MODULES if (lines := long_first_lines(path))}
    assert not found, "a docstring's first line says what the thing is, in 100 characters; reasons come below it"


@pytest.mark.parametrize("path", [path for path in MODULES if not path.name.startswith("__")], ids=relative)
def test_a_module_is_named_after_its_main_content(path):
    assert is_named_after_its_content(path), "its docstring's first line has no word of its name, its largest definition neither"
