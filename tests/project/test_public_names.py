"""Public signatures hold no private types, and public names are those of the stub."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pm3dof_pin as pm

PACKAGE = Path(pm.__file__).parent
MODULES = sorted(path for path in PACKAGE.rglob("*.py") if "cli" not in path.relative_to(PACKAGE).parts)


def _names(annotation: ast.expr | None) -> Iterator[str]:
    """Yield the names in an annotation, also inside quotes."""
    for node in ast.walk(annotation) if annotation is not None else ():
        if isinstance(node, ast.Name):
            yield node.id
        elif isinstance(node, ast.Attribute):
            yield node.attr
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value.isidentifier():
            yield node.value


def _signatures(module: ast.Module) -> Iterator[tuple[str, list[ast.expr | None]]]:
    """Yield public functions, methods and fields, each with its annotations."""
    for node in module.body:
        members = [(node, "")]
        if isinstance(node, ast.ClassDef):
            members = [(member, f"{node.name}.") for member in node.body]  # type: ignore[misc]
        if getattr(node, "name", "").startswith("_"):
            continue
        for member, prefix in members:
            if isinstance(member, ast.FunctionDef) and (not member.name.startswith("_") or member.name == "__init__"):
                given = member.args
                arguments = [*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg]
                yield prefix + member.name, [member.returns, *(a.annotation for a in arguments if a is not None)]
            elif prefix and isinstance(member, ast.AnnAssign) and not ast.unparse(member.target).startswith("_"):
                yield prefix + ast.unparse(member.target), [member.annotation]


def test_no_private_type_in_a_public_signature() -> None:
    private = [
        f"{path.relative_to(PACKAGE)}: {name}: {word}"
        for path in MODULES
        for name, annotations in _signatures(ast.parse(path.read_text(encoding="utf-8")))
        for annotation in annotations
        for word in _names(annotation)
        if word.startswith("_")
    ]
    assert len(MODULES) > 200
    assert not private


def test_the_walk_finds_private_types() -> None:
    """The walk itself: a return value, an argument in quotes, a field, a constructor; not what is private anyway."""
    text = (
        "def f(x: '_A') -> list[_B]: ...\nclass C:\n    y: tuple[_D, int]\n    _z: _E\n"
        "    def __init__(self, *w: _F) -> None: ...\n    def _g(self) -> _G: ...\nclass _H:\n    i: _I\n"
    )
    found = {word for _, annotations in _signatures(ast.parse(text)) for a in annotations for word in _names(a)}
    assert {word for word in found if word.startswith("_")} == {"_A", "_B", "_D", "_F"}


def test_the_public_names_are_few_and_real() -> None:
    assert 25 <= len(pm.__all__) <= 45
    for name in pm.__all__:
        assert getattr(pm, name).__doc__, name
