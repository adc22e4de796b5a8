"""The core as a pipeline: no stage assigns to an object of another one."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import gcs_coloc.core

CORE = Path(gcs_coloc.core.__file__).parent
MODULES = sorted(CORE.rglob("*.py"))


def targets(tree: ast.AST) -> Iterator[ast.Attribute]:
    """Every attribute that a piece of code assigns to."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node


def foreign_arguments(function: ast.FunctionDef, own_classes: set[str]) -> set[str]:
    """The arguments of a function that are of no class of its own module."""
    arguments = (*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs)
    annotated = {a.arg: ast.unparse(a.annotation) for a in arguments if a.annotation is not None}
    return {name for name, annotation in annotated.items() if not any(own in annotation for own in own_classes)}


def test_no_function_assigns_to_what_another_module_handed_it():
    offending = []
    for file in MODULES:
        tree = ast.parse(file.read_text())
        own_classes = {node.name for node in ast.walk(tree) if isinstance(node, ast.ClassDef)}
        offending += [
            f"{file.relative_to(CORE)}, {function.name}: {ast.unparse(target)}"
            for function in ast.walk(tree)
            if isinstance(function, ast.FunctionDef)
            for target in targets(function)
            if isinstance(target.value, ast.Name) and target.value.id in foreign_arguments(function, own_classes)
        ]
    assert offending == []


def test_the_engine_assigns_to_nothing_but_itself():
    tree = ast.parse((CORE / "engine.py").read_text())
    assert {ast.unparse(target.value) for target in targets(tree)} == {"self"}
