"""The page on the chapter names only existing things, and omits no equation, table or figure."""

from __future__ import annotations

import pkgutil
import re
from pathlib import Path

import pytest

from pm3dof_pin.cli.app import COMMANDS

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "chapter_statements.md").read_text(encoding="utf-8")
ROWS = "\n".join(line for line in PAGE.splitlines() if line.startswith("|"))
CODE = sorted(set(re.findall(r"`([^`]+)`", ROWS)))


FUNCTIONS = [code for code in CODE if re.fullmatch(r"[a-z_]+(\.\w+)+", code) and not code.endswith((".py", ".yaml"))]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_exist(name: str) -> None:
    pkgutil.resolve_name(f"pm3dof_pin.{name.removeprefix('pm.')}")


@pytest.mark.parametrize("name", sorted(set(re.findall(r"`pm3dof ([a-z0-9-]+)", ROWS))))
def test_commands_exist(name: str) -> None:
    assert name in COMMANDS


@pytest.mark.parametrize("name", [code for code in CODE if code.endswith(".py")])
def test_scripts_exist(name: str) -> None:
    assert (ROOT / "scripts" / name.removeprefix("scripts/")).is_file()


def test_nothing_of_the_chapter_is_missing() -> None:
    equations = {int(number) for number in re.findall(r"\(8\.(\d+)\)", ROWS)}
    ranges = re.findall(r"\(8\.(\d+)\) to \(8\.(\d+)\)", ROWS)
    equations |= {number for first, last in ranges for number in range(int(first), int(last) + 1)}
    assert equations == set(range(1, 18))
    assert {int(number) for number in re.findall(r"Table 8\.(\d)", ROWS)} == {1, 2, 3, 4}
    assert {int(number) for number in re.findall(r"Fig\. 8\.(\d)", ROWS)} == {1, 2, 3, 4, 5, 6}
    assert re.findall(r"^## (8\.\d(?:\.\d)?)", PAGE, re.MULTILINE) == ["8.1", "8.2.1", "8.2.2", "8.2.3", "8.3", "8.4"]
