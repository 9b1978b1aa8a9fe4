"""The C source: its comment, and in-place use."""

from __future__ import annotations

import ctypes
import shutil
import subprocess

import numpy as np
import pytest

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.programs.c import c99
from pm3dof_pin.programs.graph import Graph


@pytest.fixture
def program():
    graph = Graph()
    a, b, k = graph.input("a", [1.0]), graph.input("b", [2.0]), graph.parameter("k", 3.0)
    return graph.program("swap", {"swapped": [b, a], "matrix": [[a * k, 0.0], [0.0, b * k]]})


def test_comment_tells_arguments_and_units(program):
    source = c99(program, summary="Swaps */ two lengths.", descriptions={"a": "first length [m]", "matrix": "[N/m]"})
    assert "Swaps * / two lengths." in source
    assert " *   x[0]  a: first length [m]\n *   x[1]  b\n" in source
    assert " * p[1], parameters, the same for all poses:\n *   p[0]  k\n" in source
    assert " *   y[0] .. y[1]  swapped\n *   y[2] .. y[5]  matrix: [N/m]  (2 x 2, row by row)\n" in source
    assert "swap_parameters" not in source


def test_table_of_parameters(program):
    assert "const double swap_parameters[1] = {\n  (-2.5), /* k */\n};" in c99(program, summary="", parameters=[-2.5])
    with pytest.raises(InvalidValueError, match="expected 1 values"):
        c99(program, summary="", parameters=[1.0, 2.0])


def test_outputs_may_take_the_place_of_inputs(program, tmp_path):
    compiler = shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("no C compiler")
    source, library = tmp_path / "swap.c", tmp_path / "swap.so"
    source.write_text(c99(program, summary="Swaps.", parameters=[3.0]))
    subprocess.run([compiler, "-std=c99", "-shared", "-fPIC", source, "-o", library], check=True, timeout=100)
    loaded = ctypes.CDLL(str(library))
    numbers = (ctypes.c_double * 6)(1.0, 2.0)
    loaded.swap(numbers, (ctypes.c_double * 1).in_dll(loaded, "swap_parameters"), numbers)
    assert np.array_equal(numbers, [2.0, 1.0, 3.0, 0.0, 0.0, 6.0])
