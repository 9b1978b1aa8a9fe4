"""The walk to a pose: machine code, C and JavaScript arrive where NumPy does, for every robot, also out of reach."""

from __future__ import annotations

import ctypes
import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from pm3dof_pin.description.robots import robot_names
from pm3dof_pin.kinematics.closing_programs import program_source
from pm3dof_pin.kinematics.continuation import Continuation
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.kinematics.units import coordinate_scales
from pm3dof_pin.programs.c import c99
from pm3dof_pin.programs.javascript import javascript
from pm3dof_pin.programs.walk import OPEN, REACHED, TOO_FAR, Walk

TARGETS = 1000
MACHINES = Path(__file__).parents[1] / "machines"
ROBOTS = (*robot_names(), *(path.name for path in sorted(MACHINES.iterdir())))
CASES = [(name, given) for name in ROBOTS for given in ("coordinates", "commands")]


class Case(NamedTuple):
    """A walk, from home to random targets, and where it leads with NumPy."""

    solver: Continuation
    values: np.ndarray
    parameters: np.ndarray
    walk: Walk
    start: np.ndarray
    targets: np.ndarray
    q: np.ndarray
    status: np.ndarray


@cache
def load(name: str) -> Robot:
    folder = MACHINES / name
    return Robot.load(next(folder.glob("*.xml"), folder) if folder.exists() else name)


@cache
def walked(name: str, given: str) -> Case:
    robot = load(name)
    solver = Continuation(robot, robot.coordinates if given == "coordinates" else robot.command_coordinates)
    home = solver.read(solver._home[None])
    generator = np.random.default_rng(0)
    widths = generator.choice([0.1, 0.4, 1.2], (TARGETS, 1)) * coordinate_scales(robot, solver._coordinates)
    values = home + generator.uniform(-1.0, 1.0, (TARGETS, home.shape[1])) * widths
    values[3], values[4], values[5] = np.nan, home + 1e5 * coordinate_scales(robot, solver._coordinates), home
    targets = solver._given_numbers(values)
    walk, parameters = program_source(robot).printable_walk(robot, solver._task)
    start = np.tile(solver._home, (TARGETS, 1))
    q, status = walk.evaluate(start, targets, parameters)
    return Case(solver, values, parameters, walk, start, targets, q, status)


def assert_same(case: Case, q: np.ndarray, status: np.ndarray) -> None:
    """Compare ends with those of NumPy, to rounding."""
    np.testing.assert_array_equal(status == REACHED, case.status == REACHED)
    reached = case.status == REACHED
    np.testing.assert_allclose(q[reached], case.q[reached], rtol=0, atol=1e-12)


@pytest.mark.parametrize(("name", "given"), CASES)
def test_numpy(name: str, given: str) -> None:
    """Poses that are reached are closed, by Pinocchio's kinematics; home is reached, and nonsense is not."""
    case, robot = walked(name, given), load(name)
    reached = case.status == REACHED
    assert reached[5]
    assert reached.sum() > 100 or (name, given) == ("four_rrr", "commands")  # four drives of three degrees of freedom
    assert case.status[3] == TOO_FAR
    for q in case.q[reached][:20]:
        assert robot.configuration(q).closure_residual < 1e-11


@pytest.mark.parametrize(("name", "given"), CASES)
def test_machine_code(name: str, given: str) -> None:
    case = walked(name, given)
    ends, _ = case.solver._reached(case.start, case.values)
    assert_same(case, ends, np.where(np.isnan(ends[:, 0]), OPEN, REACHED))
    alone, _ = case.solver._reached(case.start[7:8], case.values[7:8])
    np.testing.assert_array_equal(alone[0], ends[7])


@pytest.mark.parametrize(("name", "given"), CASES)
def test_c(name: str, given: str, compiled_c: Callable[[str], Any]) -> None:
    case = walked(name, given)
    go = compiled_c(c99(case.walk.renamed("go"))).go
    pointer = np.ctypeslib.ndpointer(dtype=np.float64, flags="C_CONTIGUOUS")
    go.argtypes = (pointer, pointer, pointer, ctypes.c_int, pointer)
    q, status = np.full_like(case.q, -7.0), np.empty(TARGETS)
    for k in range(TARGETS):
        status[k] = -go(case.start[k], case.targets[k], case.parameters, 100_000, q[k])
    assert_same(case, q, status)
    assert (q[status != REACHED] == -7.0).all()
    assert go(case.start[0], case.targets[0], case.parameters, 1, np.empty(case.walk.nq)) == 4


@pytest.mark.parametrize(("name", "given"), CASES)
def test_javascript(name: str, given: str, run_javascript: Callable[[str, str], Any]) -> None:
    case = walked(name, given)
    rows = json.dumps([[repr(x) for x in row] for row in case.targets.tolist()])
    source = f"""{javascript(case.walk.renamed("go"), case.parameters)}
        const start = {json.dumps(case.start[0].tolist())};
        function end(row) {{
          const q = new Float64Array(start.length).fill(-7);
          return [go(start, row.map(Number), q), ...q];
        }}"""
    results = np.array(run_javascript(source, f"{rows}.map(end)"), dtype=float)
    assert_same(case, results[:, 1:], results[:, 0])
    assert (results[results[:, 0] != REACHED, 1:] == -7.0).all()
