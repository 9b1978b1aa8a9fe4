"""Programs printed as JavaScript and run by Node, compared with the same programs run by NumPy."""

from __future__ import annotations

import json
import shutil
import subprocess

import numpy as np
import pytest

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.programs.graph import Graph, absolute, atan2, cos, less, maximum, minimum, select, sin, sqrt
from pm3dof_pin.programs.javascript import javascript
from pm3dof_pin.programs.program import Program

PARAMETERS = [-1.5, 0.25]


@pytest.fixture(scope="module")
def program() -> Program:
    """Every operation, on two inputs and two parameters."""
    graph = Graph()
    a, b = graph.input("a", [0.1, -2.0]), graph.input("b", [0.3, 5.0])
    p, q = graph.parameter("p", PARAMETERS[0]), graph.parameter("q", PARAMETERS[1])
    either = (less(a, b) & less(b, p)) | ~less(p, a)
    numbers = [a + p, a - q, -(a * p), p / b, sqrt(a), sin(a), cos(b), atan2(a, b), absolute(a), minimum(a, b)]
    numbers += [maximum(a, b), select(either, a, b), minimum(sqrt(a), b), maximum(b, sqrt(a)), a * -2.5, 1e-300 * b]
    return graph.program("everything", {"numbers": numbers})


def run(source: str, call: str, rows: np.ndarray, outputs: int) -> np.ndarray:
    node = shutil.which("node")
    if node is None:
        pytest.skip("needs Node")
    script = f"""{source}
        const rows = {json.dumps(rows.tolist())}, y = new Float64Array({outputs});
        console.log(JSON.stringify(rows.map((x) => {{ {call}; return [...y].map(String); }})));"""
    answer = subprocess.run([node, "-"], input=script, capture_output=True, text=True, check=True, timeout=60)
    return np.array(json.loads(answer.stdout), dtype=float)


def test_every_operation(program: Program) -> None:
    rows = np.vstack([np.random.default_rng(1).normal(size=(50, 2)), [[1.0, 1.0], [-1.0, 1.0], [0.0, -0.0]]])
    expected = program.evaluate(rows, PARAMETERS)
    assert np.isnan(expected).any()
    baked = run(javascript(program, PARAMETERS), "everything(x, y)", rows, expected.shape[1])
    np.testing.assert_allclose(baked, expected, rtol=1e-15, atol=0)
    given = run(javascript(program), f"everything(x, {PARAMETERS}, y)", rows, expected.shape[1])
    np.testing.assert_array_equal(given, baked)


def test_as_many_values_as_parameters(program: Program) -> None:
    with pytest.raises(InvalidValueError, match="2 values"):
        javascript(program, [1.0])
