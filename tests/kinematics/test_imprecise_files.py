"""Robots from CAD: numbers of six or seven digits, frames a micrometre off; and ranks by gap."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.exceptions import ConvergenceError
from pm3dof_pin.kinematics.degrees_of_freedom import RankDecision
from pm3dof_pin.kinematics.mobility import instantaneous_mobility
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.tolerances import IMPRECISE_AXES, RANK_CEILING

MACHINES = Path(__file__).parents[1] / "machines"
ROBOTS = ("pm3dof", "hexapod", "three_rps", "linear_delta", "delta", "five_bar", "four_bar", "three_rpr", "agile_eye")


def load(name: str) -> Robot:
    files = [*(MACHINES / name).glob("*.urdf"), *(MACHINES / name).glob("*.xml")]
    return Robot.load(files[0] if files else name)


def changed(robot: Robot, kind: str) -> Robot:
    """Return a robot read from other numbers: all placements rounded, or moved by a micrometre and a microradian.

    For the smallest machine, whose frames are 13 mm apart, it is 0.13 micrometres.
    """
    step = min(1e-6, 1e-5 * robot.characteristic_length)
    generator, model = np.random.default_rng(1), robot.model.copy()
    placements = [model.jointPlacements[k] for k in range(1, model.njoints)]
    placements += [frame.placement for frame in model.frames if frame.type != pin.FrameType.JOINT]
    for placement in placements:
        if kind == "micrometre":
            placement.translation += generator.normal(0.0, step, 3)
            placement.rotation = pin.exp3(generator.normal(0.0, step, 3)) @ placement.rotation
        else:
            digits = int(kind)
            placement.translation = np.round(placement.translation, digits)
            placement.rotation = pin.rpy.rpyToMatrix(np.round(pin.rpy.matrixToRpy(placement.rotation), digits))
    arguments = robot._arguments | {"description": None, "source": robot.name}
    return Robot(model, robot.closures, **arguments)


@pytest.mark.parametrize("kind", ["6", "7", "micrometre"])
@pytest.mark.parametrize("name", ROBOTS)
def test_an_imprecise_robot_keeps_its_mobility_and_solves(name, kind):
    exact = load(name)
    robot = changed(exact, kind)
    assert robot.home.closure_residual <= robot.closure_tolerance <= 1e-4 * max(robot.characteristic_length, 0.1)
    expected, found = instantaneous_mobility(exact.home), instantaneous_mobility(robot.home)
    for field in ("count", "tool_mobility", "redundant_constraints"):
        assert getattr(found, field) == getattr(expected, field)
    widths = [0.02 * robot.characteristic_length if c.unit == "m" else 0.02 for c in robot.coordinates]
    values = robot.home_coordinates + np.random.default_rng(2).uniform(-1.0, 1.0, (6, len(widths))) * widths
    for engine in ("program", "pinocchio"):
        poses = robot.solve(values, engine=engine)
        assert poses.residual.max() <= robot.closure_tolerance
        reference = exact.solve(values)
        scales = [
            command.scale * (robot.characteristic_length if command.unit == "m" else 1.0) for command in exact.commands
        ]
        np.testing.assert_allclose((poses.commands - reference.commands) / scales, 0.0, atol=1e-3)


def test_a_rank_is_decided_where_singular_values_fall():
    """A public biped from CAD: eight singular values above 8e-3, then three below 2.3e-7. Its mobility is 10."""
    values = np.array([1.4, 1.1, 0.9, 0.5, 0.2, 0.1, 0.03, 8e-3, 2.3e-7, 1e-7, 7.5e-8])
    decision = RankDecision.by_gap(values, 1.4, RANK_CEILING)
    assert (decision.rank, decision.is_borderline) == (8, False)
    assert decision.gap == pytest.approx(8e-3 / 2.3e-7)
    scaled = np.array([1.7, 1.7, 1.0, 1.0, 0.37, 0.36, 0.17, 0.15, 4.5e-6, 1.9e-6, 1.5e-6, 3e-16])  # by its length
    assert RankDecision.by_gap(scaled, 1.75, IMPRECISE_AXES).rank == 8
    assert RankDecision.by_gap(np.array([1.0, 1e-3, 3e-7, 1e-9]), 1.0, RANK_CEILING).rank == 2
    gradual = RankDecision.by_gap(np.array([1.0, 1e-2, 1e-4, 2e-6, 5e-7, 1e-8]), 1.0, RANK_CEILING)
    assert (gradual.rank, gradual.is_borderline) == (4, True)


def test_axes_that_are_nearly_parallel_leave_closures_redundant(tmp_path):
    """A planar loop held by two points: all but two of their rows repeat each other, if the axes are parallel."""
    aligned = TWICE_PINNED.replace("1e-6 1 .05", "0 1 .05").replace("-1e-6 1 -.05", "0 1 -.05")
    path = tmp_path / "tilted.xml"
    for tilt, tolerance in ((0.0, RANK_CEILING), (1e-4, IMPRECISE_AXES)):  # times a lever of 0.05 m: 1.7e-6
        path.write_text(aligned.replace('"pin" axis="0 0 1"', f'"pin" axis="{tilt} 0 1"'), encoding="utf-8")
        robot = Robot.load(path)
        assert robot.rank_tolerance == tolerance
        assert instantaneous_mobility(robot.home).count == 1


def test_a_declared_tolerance_is_used(tmp_path):
    exact = load("four_bar")
    model = exact.model.copy()
    tip = exact.closures[0].frame_a
    index = model.getFrameId(tip)
    model.frames[index].placement.translation[2] += 1e-4  # out of the plane: this never closes
    arguments = exact._arguments | {"description": None}
    with pytest.raises(ConvergenceError):
        Robot(model, exact.closures, **arguments).forward([0.1])
    robot = Robot(model, exact.closures, **(arguments | {"closure_tolerance": 2e-4}))
    assert robot.forward([0.1]).residual == pytest.approx(1e-4, rel=1e-6)
    assert Robot.load(MACHINES / "four_bar" / "four_bar.urdf", closure_tolerance=1e-7).closure_tolerance == 1e-7


# a parallelogram held together at both ends of its pins, which are askew by micrometres on one side
TWICE_PINNED = """<mujoco><worldbody>
<body name="crank"><joint name="crank" axis="0 0 1" range="-1 1"/><geom size=".01" fromto="0 0 0 0 1 0" type="capsule"/>
  <body name="coupler" pos="0 1 0"><joint name="pin" axis="0 0 1"/>
    <geom size=".01" fromto="0 0 0 1 0 0" type="capsule"/>
    <site name="a" pos="1 0 .05"/><site name="b" pos="1 0 -.05"/></body></body>
<body name="rocker" pos="1 0 0"><joint name="rocker" axis="0 0 1"/>
  <geom size=".01" fromto="0 0 0 0 1 0" type="capsule"/>
  <site name="c" pos="1e-6 1 .05"/><site name="d" pos="-1e-6 1 -.05"/></body></worldbody>
<equality><connect site1="a" site2="c"/><connect site1="b" site2="d"/></equality>
<actuator><motor joint="crank"/></actuator></mujoco>"""


def test_loops_that_cannot_close_fully_have_programs(tmp_path):
    """Redundant constraints of a robot out of CAD contradict each other by a micrometre, in every pose."""
    path = tmp_path / "twice_pinned.xml"
    path.write_text(TWICE_PINNED, encoding="utf-8")
    robot = Robot.load(path)
    assert robot.home.closure_residual > 5e-8
    assert robot.reason_without_programs() is None
    np.testing.assert_array_equal(robot.assemble().q, robot.home.q)
    angles = np.linspace(-0.8, 0.8, 5)[:, None]
    for engine in ("program", "pinocchio"):
        poses = robot.solve(angles, engine=engine)
        np.testing.assert_allclose(poses.q[:, [1, 2]], angles * [-1.0, 1.0], atol=1e-6)
