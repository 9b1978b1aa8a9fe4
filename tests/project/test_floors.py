"""Imports point from upper layers to lower ones, without cycles."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[2]

# From the lowest layer up. Subpackages of one layer may use each other, in one direction.
FLOORS = (
    ("exceptions", "files", "typing", "arrays", "csv_table", "singular_values", "tolerances"),
    ("description",),
    ("mechanism",),
    ("programs",),
    ("kinematics",),
    ("elastic",),
    ("chapter",),
    ("dynamics",),
    ("capability",),
    ("errors",),
    ("measuring",),
    ("simulation",),
    ("maps",),
    ("figures", "viewer", "export"),
    ("calibration",),
    ("paths", "printers"),
    ("cli",),
    ("__main__",),
)
FLOOR_OF = {room: floor for floor, rooms in enumerate(FLOORS) for room in rooms}


# Every module of the package but its __init__, which holds the version and the lazy list of public names.
MODULES = {
    ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): file
    for file in (ROOT / "pm3dof_pin").rglob("*.py")
    if file.parent != ROOT / "pm3dof_pin" or file.name != "__init__.py"
}


@cache
def _parsed(module: str) -> ast.Module:
    return ast.parse(MODULES[module].read_text(encoding="utf-8"), filename=str(MODULES[module]))


def _imports(nodes: Iterable[ast.AST]) -> set[str]:
    names: set[str] = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "a relative import hides which room it goes to"
            members = {f"{node.module}.{alias.name}" for alias in node.names}
            names |= (members & set(MODULES)) or {str(node.module)}
    return names


def _statements(nodes: Iterable[ast.AST], *, types: bool = True) -> Iterator[ast.AST]:
    """Return statements, nested ones included: only these can be imports, and most nodes are expressions.

    Without `types`, those under `if TYPE_CHECKING` are left out.
    """
    for node in nodes:
        if not types and isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING":
            continue
        yield node
        for block in ("body", "orelse", "handlers", "finalbody", "cases"):
            yield from _statements(getattr(node, block, ()), types=types)


@cache
def _everything(module: str) -> set[str]:
    return _imports(_statements(_parsed(module).body))


@cache
def _run(module: str) -> set[str]:
    """Modules of the package that a module imports when it is loaded or used."""
    return _imports(_statements(_parsed(module).body, types=False)) & set(MODULES) - {module}


def _anywhere(module: str) -> set[str]:
    """Modules of the package that a module imports: at its top, inside functions, or for typing only."""
    return _everything(module) & set(MODULES) - {module}


def _room(module: str) -> str:
    return module.split(".")[1]


def test_imports_point_down() -> None:
    homeless = [module for module in MODULES if _room(module) not in FLOOR_OF]
    assert not homeless, f"on no floor: {', '.join(homeless)}; add their rooms to FLOORS and to CONTRIBUTING.md"
    upwards = [
        f"{module} imports {name}"
        for module in sorted(MODULES)
        for name in _anywhere(module)
        if FLOOR_OF[_room(name)] > FLOOR_OF[_room(module)]
    ]
    assert not upwards, f"from floors above their own: {', '.join(upwards)}"


def test_rooms_do_not_import_each_other_in_a_circle() -> None:
    graph: dict[str, set[str]] = {}
    for module in MODULES:
        graph.setdefault(_room(module), set()).update({_room(name) for name in _anywhere(module)} - {_room(module)})
    TopologicalSorter(graph).prepare()  # raises CycleError, which names the cycle


def test_modules_do_not_import_each_other_in_a_circle() -> None:
    """Imports inside functions count too: Python does not notice their cycles. Those for annotations alone do not."""
    TopologicalSorter({module: _run(module) for module in MODULES}).prepare()


def test_the_package_imports_neither_scripts_nor_tests() -> None:
    first_names = {name.split(".")[0] for module in MODULES for name in _everything(module)}
    assert not first_names & {"scripts", "tests", "benchmarks", "docs", "pytest"}


def test_commands_import_at_the_top_of_their_modules() -> None:
    """But for what draws and loads Matplotlib or Rich, for what quick commands do not need (the compiler, the
    machine of `--config`), and for completion, which runs at every press of Tab.
    """
    drawing = ("pm3dof_pin.figures.", "pm3dof_pin.paths.report", "matplotlib", "rich.")
    slow = (*drawing, "pm3dof_pin.maps.quantities", "pm3dof_pin.export.description")
    for module in MODULES:
        if _room(module) == "cli" and not module.endswith((".completion", ".stiffness_map")):
            top = set(_parsed(module).body)
            nested = _imports(node for node in _statements(_parsed(module).body, types=False) if node not in top)
            unexpected = sorted(name for name in nested if not name.startswith(slow))
            assert not unexpected, f"{module} imports inside functions: {', '.join(unexpected)}"
