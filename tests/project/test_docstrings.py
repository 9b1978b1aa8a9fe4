"""Examples in docstrings: they run, and every public name has one."""

from __future__ import annotations

import ast
import doctest
import importlib
from pathlib import Path

import pytest

import pm3dof_pin

ROOT = Path(__file__).parents[2]
LIKE = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def _modules_with_examples() -> list[str]:
    """Modules with a prompt in docstrings, found without importing them."""
    names = []
    for path in sorted((ROOT / "pm3dof_pin").rglob("*.py")):
        if ">>> " in path.read_text(encoding="utf-8"):
            names.append(".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"))
    return names


@pytest.mark.parametrize("name", _modules_with_examples())
def test_examples_run(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    module = importlib.import_module(name)
    runner = doctest.DocTestRunner(optionflags=LIKE)
    output: list[str] = []
    for test in doctest.DocTestFinder(exclude_empty=True).find(module, name):
        runner.run(test, out=output.append)
    assert not runner.failures, "".join(output)


@pytest.mark.parametrize("name", sorted(set(pm3dof_pin.__all__) - {"chapter", "PM3DofError"}))
def test_every_public_name_has_an_example(name: str) -> None:
    assert ">>> " in (getattr(pm3dof_pin, name).__doc__ or ""), f"{name} has no example in its docstring"


def test_the_stub_lists_public_names_in_order_and_from_their_own_modules() -> None:
    stub = ast.parse((ROOT / "pm3dof_pin" / "__init__.pyi").read_text(encoding="utf-8"))
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    for node in imports:
        for alias in node.names:
            assert alias.asname == alias.name, "`as` is how a stub says that a name is public"
            if node.module is not None:
                found = getattr(pm3dof_pin, alias.name)
                assert found.__module__ == f"pm3dof_pin.{node.module}"
    assert len(imports) <= 38, "about thirty names on one level; what few need is reached by its module"
