"""Printed sources: the comment of C, tables of parameters, and outputs in place of inputs."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pm3dof_pin.exceptions import ShapeError
from pm3dof_pin.programs.c import c99
from pm3dof_pin.programs.graph import Graph
from pm3dof_pin.programs.javascript import javascript
from pm3dof_pin.programs.printers import PRINTERS
from pm3dof_pin.programs.program import Program


@pytest.fixture
def program() -> Program:
    graph = Graph()
    a, b, k = graph.input("a", [1.0]), graph.input("b", [2.0]), graph.parameter("k", 3.0)
    return graph.program("swap", {"swapped": [b, a], "matrix": [[a * k, 0.0], [0.0, b * k]]})


def test_comment_tells_arguments_and_units(program: Program) -> None:
    source = c99(program, summary="Swaps */ two lengths.", descriptions={"a": "first length [m]", "matrix": "[N/m]"})
    assert "Swaps * / two lengths." in source
    assert " *   x[0]  a: first length [m]\n *   x[1]  b\n" in source
    assert " * p[1], parameters, the same for all poses:\n *   p[0]  k\n" in source
    assert " *   y[0] .. y[1]  swapped\n *   y[2] .. y[5]  matrix: [N/m]  (2 x 2, row by row)\n" in source
    assert "swap_parameters" not in source


def test_values_of_parameters(program: Program) -> None:
    assert "const double swap_parameters[1] = {\n  (-2.5), /* k */\n};" in c99(program, parameters=[-2.5])
    for printer in PRINTERS.values():
        with pytest.raises(ShapeError, match="1 values"):
            printer(program, parameters=[1.0, 2.0])


@pytest.mark.parametrize("file", ["test_agreement.py", "test_walk.py"])
def test_programs_and_walks_are_run_in_every_language(file: str) -> None:
    """By a test named after the module that prints it."""
    text = Path(__file__).with_name(file).read_text(encoding="utf-8")
    modules = [printer.__module__.rpartition(".")[2] for printer in PRINTERS.values()]
    assert [name for name in modules if f"\ndef test_{name}(" not in text] == []


def test_outputs_may_take_the_place_of_inputs_in_c(program: Program, compiled_c: Callable[[str], Any]) -> None:
    loaded = compiled_c(c99(program, parameters=[3.0]))
    numbers = (ctypes.c_double * 6)(1.0, 2.0)
    loaded.swap(numbers, (ctypes.c_double * 1).in_dll(loaded, "swap_parameters"), numbers)
    assert np.array_equal(numbers, [2.0, 1.0, 3.0, 0.0, 0.0, 6.0])


def test_outputs_may_take_the_place_of_inputs_in_javascript(
    program: Program, run_javascript: Callable[[str, str], Any]
) -> None:
    source = f"{javascript(program, [3.0])}; const x = [1, 2, 0, 0, 0, 0]; swap(x, x);"
    assert list(map(float, run_javascript(source, "x"))) == [2.0, 1.0, 3.0, 0.0, 0.0, 6.0]
