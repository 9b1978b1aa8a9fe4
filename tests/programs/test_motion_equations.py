"""Motions of two chains that closures of every type join again and again: against null spaces and the reference engine.

A ladder has as many rungs as it takes for the joints below a rung to be substituted by what that rung leaves free. At
each rung both chains get some joints, as many as the closure holds and one more, so that the ladder has as many degrees
of freedom as rungs.
"""

from __future__ import annotations

import sys
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pm3dof_pin as pm
from pm3dof_pin.description.closure_types import CLOSURE_TYPES
from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.dynamics.batch import actuator_forces, drive_mass_matrices
from pm3dof_pin.errors.error_parameters import GeometricErrors, all_parameters
from pm3dof_pin.errors.sensitivity import closable
from pm3dof_pin.kinematics.branches import samples_near_home
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.programs.closed_motions import all_motions, closed_motions
from pm3dof_pin.programs.elimination import Doubt, samples, zeros
from pm3dof_pin.programs.graph import Graph, is_zero
from pm3dof_pin.programs.motion_equations import joint_columns, motion_equations
from pm3dof_pin.programs.tool_motion import Displacement, response_to_displacements
from pm3dof_pin.programs.tree import Tree
from pm3dof_pin.typing import Array, Objects

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts" / "benchmarks"))
from families import scissor

_RUNGS = 5
_REGULAR = 0.03  # least singular value of the constraint Jacobian of the passive joints
_AXES = "xyz"


def _placement(rng: np.random.Generator) -> pin.SE3:
    turn = pin.Quaternion(*rng.normal(size=4)).normalized().toRotationMatrix()
    return pin.SE3(turn, rng.uniform(-0.3, 0.3, 3))


def _permitted(kind: str, rng: np.random.Generator) -> pin.SE3:
    """A placement of frame b in frame a that a type permits, by the definition of the joint."""
    row = CLOSURE_TYPES[kind]
    if row.is_distance:
        return _placement(rng)
    shift = [0.0 if axis in row.translations else rng.uniform(-0.2, 0.2) for axis in range(3)]
    angles = rng.uniform(-0.7, 0.7, 3)
    about = {(): "xyz", (2,): "xy", (0, 1): "z", (0, 1, 2): ""}[row.rotations]
    turn = np.eye(3)
    for axis in about:
        turn = turn @ pin.utils.rotate(axis, angles[_AXES.index(axis)])
    return pin.SE3(turn, np.array(shift))


def _ladder(kind: str, rng: np.random.Generator) -> Robot:
    row, model, loops, springs = CLOSURE_TYPES[kind], pin.Model(), [], list[dict[str, Any]]()
    model.name, ends, number = kind, [0, 0], count()
    for rung in range(_RUNGS):
        for k in range(row.size + 1):
            side, name = k % 2, f"joint{next(number)}"
            slides = row.size > 1 and k == 2
            turns = (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ)[k % 3]
            ends[side] = model.addJoint(ends[side], pin.JointModelPY() if slides else turns(), _placement(rng), name)
            model.appendBodyToJoint(ends[side], pin.Inertia.FromSphere(rng.uniform(0.5, 2.0), 0.1), _placement(rng))
            unit = "N/m" if slides else "N m/rad"
            springs.append({"name": name, "type": "joint", "joint": name, "stiffness": 3e4, "unit": unit})
        data = model.createData()
        pin.forwardKinematics(model, data, pin.neutral(model))
        a, b = _placement(rng), _permitted(kind, rng)
        at_b = data.oMi[ends[1]].actInv(data.oMi[ends[0]] * a * b)
        for name, side, place in ((f"a{rung}", 0, a), (f"b{rung}", 1, at_b)):
            model.addFrame(pin.Frame(name, ends[side], 0, place, pin.FrameType.OP_FRAME))
        length = float(np.linalg.norm(b.translation)) if row.is_distance else None
        loops.append(LoopClosure(f"a{rung}", f"b{rung}", kind, length=length))  # type: ignore[arg-type]
    model.addFrame(pin.Frame("tool", ends[0], 0, _placement(rng), pin.FrameType.OP_FRAME))
    model.referenceConfigurations["home"] = pin.neutral(model)
    drives = [f"joint{rung * (row.size + 1)}" for rung in range(_RUNGS)]
    return Robot(model, loops, actuated_joints=drives, tool_frame="tool", springs=springs)


@pytest.fixture(scope="module", params=CLOSURE_TYPES)
def ladder(request: pytest.FixtureRequest) -> Robot:
    """The first random ladder that is far from singular."""
    for seed in range(200):
        robot = _ladder(request.param, np.random.default_rng(seed))
        jacobian = robot.home.constraint_jacobian / robot.closure_scale[:, None]
        if np.linalg.svd(jacobian[:, robot.passive_indices], compute_uv=False)[-1] > _REGULAR:
            return robot
    raise AssertionError("no regular ladder")


def _at(numbers: Objects, pose: int, count: int) -> Array:
    """Values of recorded numbers at a sample pose."""
    return np.array(
        [[np.broadcast_to(samples(entry), count)[pose] for entry in row] for row in numbers], dtype=float
    ).reshape(numbers.shape)


def test_motions_are_the_null_space(ladder: Robot) -> None:
    poses = samples_near_home(ladder)
    tree, unit = Tree(Graph(), ladder, poses), ladder.length_unit
    driven, passive = ladder.actuated_indices.tolist(), ladder.passive_indices.tolist()
    own = closed_motions(tree, driven, passive, unit, Doubt())
    every = all_motions(tree, [*passive, *driven], unit, Doubt())
    assert not own.idle.size
    assert not own.relations.size
    for pose, q in enumerate(poses):
        jacobian = ladder.configuration(q).constraint_jacobian / ladder.closure_scale[:, None]
        jacobian[:, tree.slides] *= unit
        for motions in (own.rates, every):
            values = _at(motions, pose, len(poses))
            assert values.shape == (ladder.model.nv, _RUNGS)
            assert np.linalg.svd(values, compute_uv=False)[-1] > 1e-2
            np.testing.assert_allclose(jacobian @ values, 0.0, atol=1e-9 * np.abs(values).max())


def test_equations_name_what_is_near(ladder: Robot) -> None:
    """Without substitutes the last rung would name the joints of all."""
    (loop, *_), kind = ladder.closures, ladder.closures[0].kind
    tree = Tree(Graph(), ladder, samples_near_home(ladder))
    equations = motion_equations(tree, ladder.length_unit, joint_columns(tree, range(ladder.model.nv)))
    free = equations.unknown - ladder.model.nv
    if loop.kind.is_distance or loop.kind.rotations == (2,):
        assert free == 0
        return
    own = kind.size + 1
    entries = np.array([[not is_zero(entry) for entry in row] for row in equations.rates])
    rungs = [rung for rung in range(1, _RUNGS) if rung * own > 2 * (6 - kind.size)]  # joints below that are worth it
    assert rungs
    assert free == (6 - kind.size) * len(rungs)
    assert entries.sum(axis=1).max() <= max(own + 6 - kind.size, own * rungs[0]) + 1


def test_compliance_and_statics_in_both_engines(ladder: Robot) -> None:
    commands = np.random.default_rng(3).uniform(-0.01, 0.01, (40, _RUNGS))
    poses = ladder.forward(commands)
    reference = ladder.with_engine("pinocchio").forward(commands)
    assert poses.solved.all()
    for quantity in (pm.compliance, actuator_forces, drive_mass_matrices):
        found, expected = quantity(ladder, poses), quantity(ladder.with_engine("pinocchio"), reference)
        np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def test_sensitivities_in_both_engines(ladder: Robot) -> None:
    errors = GeometricErrors(ladder, all_parameters(ladder))
    errors = errors if ladder.closures[0].kind.is_distance else errors.select(closable(errors).names[::7])
    poses = ladder.forward(np.random.default_rng(4).uniform(-0.01, 0.01, (40, _RUNGS)))
    program = pm.sensitivities(errors, poses)
    reference = pm.sensitivities(errors, poses, engine="pinocchio")
    np.testing.assert_allclose(program.errors, reference.errors, atol=1e-9 * np.abs(reference.errors).max())
    np.testing.assert_allclose(program.commands, reference.commands, atol=1e-9 * np.abs(reference.commands).max())


def test_balls_let_an_end_turn_out_of_the_plane_of_a_lift(tmp_path: Path) -> None:
    """No joint can turn it that way, but an error of its placement does, and the tool stays."""
    lift = Robot.load(scissor(8).write(tmp_path))
    tree = Tree(Graph(), lift, samples_near_home(lift))
    turn = zeros(6, 1)
    turn[3, 0] = 1.0
    ends = [Displacement(tree.frame(loop.frame_b), frozenset({loop.frame_b}), turn) for loop in lift.closures]
    driven, tool = lift.actuated_indices.tolist(), lift.frame_name()
    columns = [joint_columns(tree, indices, tool) for indices in (lift.passive_indices.tolist(), driven)]
    by_errors, by_drives = response_to_displacements(tree, tool, columns[0], columns[1], ends, Doubt())
    for entry in by_errors.ravel():
        np.testing.assert_allclose(samples(entry), 0.0, atol=1e-12)
    assert max(np.max(np.abs(samples(entry))) for entry in by_drives.ravel()) > 0.1
