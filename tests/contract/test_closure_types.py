"""One contract for every type of closure: rows, drift, both engines, errors, springs, forces, and mobility by Gruebler.

The machine is a chain of random joints on a body that itself turns, closed on that body: as many joints as the closure
has rows, and one more. By Gruebler's count it has two degrees of freedom.
"""

from __future__ import annotations

from itertools import count
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import pytest

import pm3dof_pin as pm
from pm3dof_pin.description.closure_types import CLOSURE_TYPES
from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.dynamics.inverse_dynamics import _loop_motion
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.errors.error_parameters import GeometricErrors, all_parameters
from pm3dof_pin.errors.sensitivity import closable
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.closure_wrenches import closure_wrenches, turning_stiffness
from pm3dof_pin.typing import Array

_STEP = 1e-6
_REGULAR = 0.1  # least singular value of the constraint Jacobian of the passive joints


class _Case(NamedTuple):
    kind: str
    axes: bool


_CASES = [
    _Case(name, axes)
    for name, row in CLOSURE_TYPES.items()
    for axes in (False, True)
    if row.axis is not None or not axes
]


def _rotation(axis: str, angle: float) -> pin.SE3:
    return pin.SE3(pin.utils.rotate(axis, angle), np.zeros(3))


def _shift(*position: float) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array(position))


_RELATIVE: dict[str, pin.SE3] = {
    "3d": _rotation("x", 0.4) * _rotation("z", -0.7),
    "6d": pin.SE3.Identity(),
    "hinge": _rotation("z", 0.6),
    "universal": _rotation("x", 0.5) * _rotation("y", -0.3),
    "prismatic": _shift(0.0, 0.0, 0.12),
    "cylindrical": _shift(0.0, 0.0, 0.12) * _rotation("z", 0.6),
    "planar": _shift(0.1, -0.15, 0.0) * _rotation("z", 0.6),
    "distance": _shift(0.2, 0.1, -0.2) * _rotation("x", 0.4),
}
"""Placements of frame b in frame a that each type permits, by the definition of the joint."""


def _placement(rng: np.random.Generator) -> pin.SE3:
    turn = pin.Quaternion(*rng.normal(size=4)).normalized().toRotationMatrix()
    return pin.SE3(turn, rng.uniform(-0.3, 0.3, 3))


def _machine(case: _Case, springs: bool = False) -> Robot:
    """The first random machine that is far from singular."""
    for seed in count():
        robot = _random_machine(case, np.random.default_rng(seed), springs)
        jacobian = robot.home.constraint_jacobian / robot.closure_scale[:, None]
        if np.linalg.svd(jacobian[:, robot.passive_indices], compute_uv=False)[-1] > _REGULAR:
            return robot
    raise AssertionError("no regular machine")


def _random_machine(case: _Case, rng: np.random.Generator, springs: bool) -> Robot:
    row = CLOSURE_TYPES[case.kind]
    model = pin.Model()
    model.name = case.kind
    joint = model.addJoint(0, pin.JointModelRZ(), _placement(rng), "base")
    base = joint
    _add_body(model, joint, rng)
    for k in range(row.size + 1):
        prismatic = k == 2
        kind = pin.JointModelPY() if prismatic else pin.JointModelRX() if k % 2 else pin.JointModelRY()
        joint = model.addJoint(joint, kind, _placement(rng), f"joint{k}")
        _add_body(model, joint, rng)
    middle = model.getJointId("joint0" if row.size < 2 else "joint1")
    model.addFrame(pin.Frame("tool", middle, 0, _placement(rng), pin.FrameType.OP_FRAME))
    tip = _placement(rng)
    model.addFrame(pin.Frame("tip", joint, 0, tip, pin.FrameType.OP_FRAME))
    axis = tuple(rng.normal(size=3)) if case.axes else None
    axis_b = tuple(rng.normal(size=3)) if case.axes and row.has_two_axes else None
    relative = _RELATIVE[case.kind]
    length = float(np.linalg.norm(relative.translation)) if row.is_distance else None
    loop = LoopClosure("seat", "tip", case.kind, axis=axis, axis_b=axis_b, length=length)  # type: ignore[arg-type]
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    at_a, at_b = (pin.SE3(basis, np.zeros(3)) for basis in loop.bases or (np.eye(3), np.eye(3)))
    seat = data.oMi[base].actInv(data.oMi[joint]) * tip * at_b * relative.inverse() * at_a.inverse()
    model.addFrame(pin.Frame("seat", base, 0, seat, pin.FrameType.OP_FRAME))
    model.referenceConfigurations["home"] = pin.neutral(model)
    entries: list[dict[str, Any]] = []
    if springs:
        entries = [
            {"name": "a", "type": "joint", "joint": "base", "stiffness": 3e4, "unit": "N m/rad"},
            {"name": "b", "type": "joint", "joint": "joint0", "stiffness": 5e4, "unit": "N m/rad"},
        ]
        if row.components:
            root = rng.normal(size=(row.size, row.size))
            matrix = 1e4 * (root @ root.T + np.eye(row.size))
            entries.append({"name": "bearing", "type": "closure", "closure": 0, "matrix": matrix.tolist()})
    return Robot(model, [loop], actuated_joints=["base", "joint0"], tool_frame="tool", springs=entries)


def _add_body(model: pin.Model, joint: int, rng: np.random.Generator) -> None:
    inertia = pin.Inertia.FromSphere(rng.uniform(0.5, 2.0), 0.1)
    model.appendBodyToJoint(joint, inertia, _shift(*rng.uniform(-0.1, 0.1, 3)))


@pytest.fixture(scope="module", params=_CASES, ids=lambda case: case.kind + "-axes" * case.axes)
def case(request: pytest.FixtureRequest) -> _Case:
    return request.param  # type: ignore[no-any-return]


@pytest.fixture(scope="module")
def robot(case: _Case) -> Robot:
    return _machine(case)


@pytest.fixture(scope="module")
def closed(robot: Robot) -> list[pm.Configuration]:
    poses = robot.with_engine("pinocchio").forward([[0.0, 0.0], [0.03, -0.02], [-0.02, 0.03]])
    return [poses[k].configuration() for k in range(3)]


def _moved(robot: Robot, q: Array, v: Array, step: float) -> pm.Configuration:
    return robot.configuration(pin.integrate(robot.model, np.array(q), step * v))


def test_the_permitted_motion_is_closed(robot: Robot) -> None:
    assert robot.home.closure_residual < 1e-14


def test_rows_are_derivatives_at_any_configuration(robot: Robot) -> None:
    rng = np.random.default_rng(1)
    for _ in range(3):
        q, v = rng.uniform(-1.0, 1.0, robot.model.nq), rng.uniform(-1.0, 1.0, robot.model.nv)
        ahead, behind = (_moved(robot, q, v, step).closure_error for step in (_STEP, -_STEP))
        rate = robot.configuration(q).constraint_jacobian @ v
        np.testing.assert_allclose((ahead - behind) / (2.0 * _STEP), rate, atol=2e-7)


def test_mobility_is_that_of_gruebler(robot: Robot, case: _Case) -> None:
    assert pm.instantaneous_mobility(robot.home).count == robot.model.nv - CLOSURE_TYPES[case.kind].size == 2


def test_drift_is_the_second_derivative_of_the_error(robot: Robot, closed: list[pm.Configuration]) -> None:
    for configuration in closed:
        motion = _loop_motion(configuration, [1.3, -0.7], [0.0, 0.0])
        v = np.array(motion.velocity)
        ahead, behind = (_moved(robot, configuration.q, v, step).constraint_jacobian @ v for step in (_STEP, -_STEP))
        drift = robot.loop_kinematics.drift(configuration.q, v)
        np.testing.assert_allclose((ahead - behind) / (2.0 * _STEP), drift, atol=1e-7)


def test_accelerations_are_those_of_the_poses_in_time(robot: Robot, closed: list[pm.Configuration]) -> None:
    start, rates, accelerations = closed[1], np.array([0.9, -0.6]), np.array([0.4, 0.5])
    motion = _loop_motion(start, rates, accelerations)
    step = 1e-4
    times = np.array([-step, 0.0, step])[:, None]
    reference = robot.with_engine("pinocchio")
    q = reference.forward(start.commands + rates * times + 0.5 * accelerations * times**2, guess=start).q
    np.testing.assert_allclose((q[2] - q[0]) / (2.0 * step), motion.velocity, rtol=1e-5, atol=1e-8)
    np.testing.assert_allclose((q[2] - 2.0 * q[1] + q[0]) / step**2, motion.acceleration, rtol=1e-4, atol=1e-5)


def test_both_engines_find_the_same_poses(robot: Robot) -> None:
    commands = np.random.default_rng(2).uniform(-0.03, 0.03, (40, 2))
    program, reference = robot.forward(commands), robot.with_engine("pinocchio").forward(commands)
    assert program.solved.all()
    np.testing.assert_allclose(program.q, reference.q, atol=1e-11)


def test_springs_give_the_same_compliance_in_both_engines(case: _Case) -> None:
    robot = _machine(case, springs=True)
    commands = np.random.default_rng(3).uniform(-0.03, 0.03, (40, 2))
    both = [pm.compliance(which, which.forward(commands)) for which in (robot, robot.with_engine("pinocchio"))]
    scale = np.abs(both[1]).max()
    np.testing.assert_allclose(both[0] / scale, both[1] / scale, atol=1e-9)


def test_a_spring_bends_the_closure_by_its_flexibility(case: _Case) -> None:
    """Compliance is the sum over springs of the squares of their strains by unit loads, computed from virtual work."""
    robot = _machine(case, springs=True)
    elastic = ElasticModel(robot)
    home = robot.home
    expected = np.zeros((6, 6))
    for k in range(6):
        forces = pm.holding_forces(home, wrenches={"tool": np.eye(6)[k]})
        weights = pm.holding_forces(home)
        drives = forces.actuator_forces - weights.actuator_forces
        closure = forces.closure_forces - weights.closure_forces
        expected[k, k] = drives @ (drives / np.array([3e4, 5e4]))
        if len(robot.springs) > 2:
            matrix = np.array(robot.springs[2]["matrix"])
            expected[k, k] += _at_first_frame(robot, closure) @ np.linalg.solve(matrix, _at_first_frame(robot, closure))
    np.testing.assert_allclose(
        np.diag(pm.cartesian_compliance(elastic, home).contributions.sum(axis=0)), np.diag(expected), rtol=1e-8
    )


def _at_first_frame(robot: Robot, forces: Array) -> Array:
    """Components of a closure's wrench that its spring takes: at the first frame's origin, in the type's axes."""
    loop = robot.closures[0]
    on_a = -closure_wrenches(robot.home, forces)[0][0]
    axes = robot.home.frame_placement("seat").rotation @ (loop.bases[0] if loop.bases else np.eye(3))
    local = np.concatenate([axes.T @ on_a[:3], axes.T @ on_a[3:]])
    return local[[("x", "y", "z", "rx", "ry", "rz").index(name) for name in loop.kind.components]]


def test_sensitivities_are_those_of_displaced_machines(robot: Robot) -> None:
    errors = GeometricErrors(robot, all_parameters(robot))
    errors = errors.select(closable(errors).names[::5])
    poses = robot.forward(np.random.default_rng(4).uniform(-0.03, 0.03, (120, 2)))
    program = pm.sensitivities(errors, poses)
    reference = pm.sensitivities(errors, poses, engine="pinocchio")
    np.testing.assert_allclose(program.errors, reference.errors, atol=1e-9)
    pose = poses[:1]
    for k, name in enumerate(errors.names):
        positions = []
        for step in (_STEP, -_STEP):
            displaced = errors.apply({name: step})
            moved = displaced.with_engine("pinocchio").forward(pose.commands, guess=pose.q)
            positions.append(moved[0].configuration().tool_placement.translation)
        rate = (positions[0] - positions[1]) / (2.0 * _STEP)
        np.testing.assert_allclose(rate, reference.errors[0, :3, k], atol=1e-6, err_msg=name)


def test_holding_forces_are_the_slopes_of_the_potential_energy(robot: Robot) -> None:
    forces = pm.holding_forces(robot.home).actuator_forces
    data = robot.model.createData()
    for k in range(2):
        poses = robot.with_engine("pinocchio").forward(np.array([_STEP, -_STEP])[:, None] * np.eye(2)[k])
        energy = [pin.computePotentialEnergy(robot.model, data, q) for q in poses.q]
        assert (energy[0] - energy[1]) / (2.0 * _STEP) == pytest.approx(forces[k], abs=1e-6)


def test_closure_wrenches_do_the_work_of_the_rows(robot: Robot, closed: list[pm.Configuration]) -> None:
    configuration = closed[2]
    forces = np.random.default_rng(5).normal(size=len(configuration.closure_error))
    ((on_a, on_b),) = closure_wrenches(configuration, forces)
    work = configuration.frame_jacobian("seat").T @ on_a + configuration.frame_jacobian("tip").T @ on_b
    np.testing.assert_allclose(work, configuration.constraint_jacobian.T @ forces, atol=1e-12)


def test_turning_closure_forces_work_on_permitted_motions(robot: Robot, closed: list[pm.Configuration]) -> None:
    """Z^T dG^T/dq lambda Z, with Z a basis of the motions that keep the loop closed, by differences of G."""
    configuration = closed[1]
    forces = np.random.default_rng(6).normal(size=len(configuration.closure_error))
    motions = np.linalg.svd(configuration.constraint_jacobian)[2][len(forces) :].T
    slopes = []
    for motion in motions.T:
        ahead, behind = (_moved(robot, configuration.q, motion, step) for step in (_STEP, -_STEP))
        slopes.append((ahead.constraint_jacobian - behind.constraint_jacobian).T @ forces / (2.0 * _STEP))
    dead = _dead(robot, configuration, forces)
    expected = motions.T @ np.array(slopes).T
    stiffness = dead + turning_stiffness(configuration, forces)
    np.testing.assert_allclose(motions.T @ stiffness @ motions, expected, atol=1e-7)


def _dead(robot: Robot, configuration: pm.Configuration, forces: Array) -> Array:
    """Derivative of the generalised forces of the closure's wrenches, both of fixed direction, by differences."""
    pairs = closure_wrenches(configuration, forces)[0]
    columns = []
    for v in np.eye(robot.model.nv):
        ahead, behind = (_moved(robot, configuration.q, v, step) for step in (_STEP, -_STEP))
        rates = [ahead.frame_jacobian(name) - behind.frame_jacobian(name) for name in ("seat", "tip")]
        columns.append(sum(rate.T @ wrench for rate, wrench in zip(rates, pairs, strict=True)) / (2.0 * _STEP))
    return np.array(columns).T
