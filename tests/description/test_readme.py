"""The README of the description: its numbers are those of the YAML, and its examples run."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from pm3dof_pin.description.parameters import TripodParameters
from pm3dof_pin.description.robots import robots_directory

README = (robots_directory() / "pm3dof_description" / "README.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)


def test_the_table_of_numbers_is_up_to_date() -> None:
    rows = re.findall(r"^\| ([a-z ]+) \| .* \| ([^|]+) \| (printed|inferred|chosen) \|$", README, flags=re.MULTILINE)
    table = {name.replace(" ", "_"): (value, status) for name, value, status in rows}
    expected = {}
    for key, quantity in TripodParameters.load().quantities.items():
        section, name = key.split(".")
        if section in ("geometry", "joints", "inertia"):
            values = quantity.value if isinstance(quantity.value, tuple) else (quantity.value,)
            unit = "" if quantity.unit == "1" else " " + quantity.unit.replace("^2", "²")
            expected[name] = (", ".join(f"{value:.10g}" for value in values) + unit, quantity.status)
    assert table == expected


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda text: re.match(r"(?:import|from) (\w+)", text)[1])
def test_the_examples_run(example: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in re.findall(r"^(?:import|from) (\w+)", example, flags=re.MULTILINE):
        pytest.importorskip(module)
    monkeypatch.chdir(Path(__file__).parents[2])
    exec(compile(example, "README.md", "exec"), {})


def test_the_picture_is_there() -> None:
    picture = re.search(r"!\[.*\]\((.*)\)", README)
    assert picture is not None
    assert (Path(__file__).parents[2] / "robots" / "pm3dof_description" / picture[1]).resolve().is_file()
