from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.exceptions import (
    ConvergenceError,
    DescriptionError,
    InvalidValueError,
    JointNotFoundError,
    PM3DofError,
    UnreachablePoseError,
)
from pm3dof_pin.kinematics import assembly
from pm3dof_pin.kinematics.assembly import assemble
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.singular_values import svd

CRANK_ROCKER = 0.2, 0.5, 0.4, 0.6


def rocker_angle(crank_angle: float, crank: float, coupler: float, rocker: float, ground: float) -> float:
    """Rocker angle of the open four-bar, by the intersection of two circles about crank tip and pivot."""
    tip = crank * np.array([np.cos(crank_angle), np.sin(crank_angle)])
    to_tip = tip - [ground, 0.0]
    distance = np.hypot(*to_tip)
    inner = np.arccos((rocker**2 + distance**2 - coupler**2) / (2.0 * rocker * distance))
    return float((np.arctan2(to_tip[1], to_tip[0]) - inner) % (2.0 * np.pi))


@pytest.fixture(scope="module")
def open_crank_rocker(crank_rocker: Robot) -> Configuration:
    """The crank-rocker with its coupler above the ground."""
    return crank_rocker.assemble(joints={"crank_joint": np.pi / 2}, guess=[0.0, 1.0, -1.0, 1.2])


@pytest.mark.parametrize("crank_angle", np.linspace(-3.1, 3.1, 13))
def test_four_bar_has_its_closed_form(
    crank_rocker: Robot, open_crank_rocker: Configuration, crank_angle: float
) -> None:
    # small steps keep the assembly mode, of which this linkage has two
    configuration = open_crank_rocker
    for angle in np.linspace(np.pi / 2, crank_angle, 12):
        configuration = crank_rocker.forward([angle], guess=configuration).configuration()
    difference = configuration.joint_position("rocker_joint") - rocker_angle(crank_angle, *CRANK_ROCKER)
    assert np.sin(difference / 2.0) == pytest.approx(0.0, abs=1e-13)
    assert configuration.commands[0] == pytest.approx(crank_angle, abs=1e-15)
    assert configuration.closure_residual < 1e-15


@pytest.mark.parametrize("seed", range(20))
def test_five_bar_closes_from_guesses_far_off(five_bar: Robot, seed: int) -> None:
    rng = np.random.default_rng(seed)
    target = rng.uniform([-0.1, 0.3], [0.1, 0.55])
    reached = five_bar.solve(target, guess=[0.0, 0.5, 2.2, -1.3, 0.9, 1.3]).configuration()
    np.testing.assert_allclose(reached.tool_placement.translation, [*target, 0.0], atol=1e-15)
    off = np.where(five_bar.velocity_scale == 1.0, rng.uniform(-0.3, 0.3, 6), rng.uniform(-0.05, 0.05, 6))
    closed = assemble(five_bar, reached.q + off)
    assert closed.converged
    assert closed.residual < 1e-15
    assert closed.steps < 15
    moved = np.abs(closed.configuration.q - reached.q - off).max()
    assert moved < 1.0, "the solution found is one near the guess"


def test_held_joints_keep_their_values_to_the_last_bit(five_bar: Robot) -> None:
    held = {"left_joint": 2.0, "y_joint": 0.45}
    closed = five_bar.assemble([0.0, 0.5, 2.2, -1.3, 0.9, 1.3], joints=held)
    assert {name: closed.joint_position(name) for name in held} == held
    assert closed.closure_residual < 1e-15


def test_forward_and_inverse_geometry_undo_each_other(five_bar: Robot) -> None:
    guess = five_bar.assemble([2.2, -1.3, 0.9, 1.3, 0.0, 0.5])
    there = five_bar.reach([0.05, 0.48, 0.0], guess=guess).configuration()
    np.testing.assert_allclose(there.tool_placement.translation, [0.05, 0.48, 0.0], atol=1e-15)
    back = five_bar.forward(there.commands, guess=guess).configuration()
    np.testing.assert_allclose(back.q, there.q, atol=1e-13)
    for pose in (there.tool_placement, there.tool_placement.homogeneous):
        np.testing.assert_allclose(five_bar.reach(pose, guess=guess).configuration().q, there.q, atol=1e-13)


def test_serial_arm_reaches_a_pose(ur5: Robot) -> None:
    rng = np.random.default_rng(8)
    for _ in range(20):
        start = ur5.configuration(rng.uniform(-1.5, 1.5, 6) + np.array([0.0, 0.0, 1.6, 0.0, 1.6, 0.0]))
        goal = ur5.configuration(start.q + rng.uniform(-0.3, 0.3, 6))
        found = ur5.reach(goal.tool_placement, guess=start).configuration()
        np.testing.assert_allclose(found.tool_placement.homogeneous, goal.tool_placement.homogeneous, atol=1e-12)


def test_joints_with_several_freedoms_are_assembled_and_held(gough: Any) -> None:
    placement = pin.SE3(pin.utils.rotate("x", 0.2) @ pin.utils.rotate("z", 0.1), np.array([0.01, -0.02, 0.1]))
    closed = gough.mechanism.assemble(joints={"platform_joint": pin.SE3ToXYZQUAT(placement)})
    heads = gough.heads @ placement.rotation.T + placement.translation
    lengths = np.linalg.norm(heads - gough.feet, axis=1)
    np.testing.assert_allclose(np.abs(closed.commands), lengths, atol=1e-14)
    assert closed.tool_placement.isApprox(placement, 1e-14)
    again = gough.mechanism.reach(placement, guess=closed).configuration()
    np.testing.assert_allclose(again.commands, closed.commands, atol=1e-14)


def test_overconstrained_loops_close_as_well(welded_four_bar: Robot) -> None:
    closed = welded_four_bar.assemble([1.4, -0.9, 0.8, 1.8], joints={"joint0": 1.4})
    assert closed.closure_residual < 1e-15
    rocker = rocker_angle(1.4, *CRANK_ROCKER)
    # the angles of joints 0, 1 and 2 add up to the rocker's direction from its tip
    direction = closed.q[:3].sum()
    assert np.cos(direction - rocker - np.pi) == pytest.approx(1.0, abs=1e-14)


@pytest.mark.parametrize("problem", ["five_bar", "welded_four_bar"])
def test_convergence_is_quadratic(problem: str, request: pytest.FixtureRequest) -> None:
    mechanism = request.getfixturevalue(problem)
    guess = {"five_bar": [0.0, 0.5, 2.2, -1.3, 0.9, 1.3], "welded_four_bar": [1.4, -0.9, 0.8, 1.8]}[problem]
    residuals = np.array([assemble(mechanism, guess, max_steps=steps).residual for steps in range(9)])
    pairs = [(now, then) for now, then in pairwise(residuals) if 1e-7 < now < 1e-1]
    assert len(pairs) >= 2
    for now, then in pairs:
        assert then < 5.0 * now**2


def test_damping_that_is_far_too_great_is_forgotten(five_bar: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """Good steps reduce it tenfold: from a billion times too much, twenty steps suffice."""
    guess = [0.0, 0.5, 2.2, -1.3, 0.9, 1.3]
    usual = assemble(five_bar, guess)
    monkeypatch.setattr(assembly, "_FIRST_DAMPING", 1e9 * assembly._FIRST_DAMPING)
    slow = assemble(five_bar, guess, max_steps=usual.steps + 12)
    assert slow.converged
    assert slow.steps > usual.steps


def test_converged_means_closed(five_bar: Robot) -> None:
    guess = [0.0, 0.5, 2.2, -1.3, 0.9, 1.3]
    interrupted = assemble(five_bar, guess, max_steps=1)
    assert not interrupted.converged
    assert interrupted.steps == 1
    assert interrupted.residual == interrupted.configuration.closure_residual > 1e-12
    at_once = assemble(five_bar, assemble(five_bar, guess).configuration)
    assert at_once.converged
    assert at_once.steps <= 1


def test_the_residual_counts_the_pose_too(five_bar: Robot) -> None:
    start = five_bar.assemble([0.0, 0.5, 2.2, -1.3, 0.9, 1.3])
    result = assemble(five_bar, start, tool={"x": start.tool_placement.translation[0] + 0.1}, max_steps=0)
    assert not result.converged
    assert result.residual == pytest.approx(0.1, rel=1e-12)


def test_a_singular_solution_is_still_found(make_four_bar: Callable[..., Robot]) -> None:
    flat = assemble(make_four_bar(0.3, 0.5, 0.3, 0.5), [0.2, -0.1, 0.15], joints={"crank_joint": 0.0})
    assert flat.converged
    assert flat.residual < 1e-12


def test_out_of_reach_is_an_error_with_the_residual(five_bar: Robot) -> None:
    # the arms are 0.7 m long, from pivots at -+0.1 m: at x = 0 they reach to y = sqrt(0.7^2 - 0.1^2)
    guess, edge = [0.0, 0.5, 2.2, -1.3, 0.9, 1.3], np.sqrt(0.48)
    assert five_bar.solve([0.0, edge - 1e-6], guess=guess).configuration().closure_residual < 1e-12
    with pytest.raises(UnreachablePoseError, match=r"x_joint = 0 m, y_joint = 0\.7\d* m: residual \d\.\d+e-0[12] m"):
        five_bar.solve([0.0, edge + 0.05], guess=guess).configuration()
    with pytest.raises(UnreachablePoseError, match=r"x = 0 m, y = 0.*residual"):
        five_bar.reach([0.0, edge + 0.05, 0.0], guess=guess).configuration()
    with pytest.raises(UnreachablePoseError):
        five_bar.reach(pin.SE3(pin.utils.rotate("x", 0.1), np.array([0.0, 0.5, 0.0])), guess=guess).configuration()


def test_loops_that_cannot_close_are_an_error_with_the_residual(crank_rocker: Robot) -> None:
    # rocker straight out: its tip is 1.0 m from the crank's pivot, crank and coupler are 0.7 m long together
    with pytest.raises(ConvergenceError) as caught:
        crank_rocker.assemble(joints={"rocker_joint": 0.0})
    assert caught.value.residual == pytest.approx(0.3, abs=1e-6)
    lengths = Robot(crank_rocker.model, crank_rocker.closures, actuated_joints=["rocker_joint"])
    with pytest.raises(ConvergenceError, match="closing the loops at home"):
        lengths.forward([0.0])


def test_a_pose_no_closure_forbids_may_be_anywhere() -> None:
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "free")
    model.addFrame(pin.Frame("tool", joint, 0, pin.SE3.Random(), pin.FrameType.OP_FRAME))
    mechanism, rng = Robot(model, tool_frame="tool"), np.random.default_rng(2)
    for _ in range(10):
        pose = pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))
        assert mechanism.reach(pose).configuration().tool_placement.isApprox(pose, 1e-12)


NOT_A_ROTATION = np.diag([1.0, 1.0, -1.0, 1.0])


@pytest.mark.parametrize(
    ("call", "error"),
    [
        (lambda m: m.assemble(guess=[0.0, 1.0]), InvalidValueError),
        (lambda m: m.assemble(guess=np.full(6, np.nan)), InvalidValueError),
        (lambda m: m.assemble(joints={"left_joint": np.nan}), InvalidValueError),
        (lambda m: m.assemble(joints={"left_joint": [0.1, 0.2]}), InvalidValueError),
        (lambda m: m.assemble(joints={"knee": 0.1}), JointNotFoundError),
        (lambda m: m.forward([0.1]).configuration(), InvalidValueError),
        (lambda m: m.forward([0.1, np.inf]).configuration(), InvalidValueError),
        (lambda m: m.forward("ab").configuration(), InvalidValueError),
        (lambda m: m.solve([0.1, 0.2, 0.3]).configuration(), InvalidValueError),
        (lambda m: m.solve([np.nan, 0.2]).configuration(), InvalidValueError),
        (lambda m: m.reach([[1.0, 0.0], [1.0]]).configuration(), InvalidValueError),
        (lambda m: m.reach(np.eye(2)).configuration(), InvalidValueError),
        (lambda m: m.reach(np.full((4, 4), np.nan)).configuration(), InvalidValueError),
        (lambda m: m.reach(NOT_A_ROTATION).configuration(), InvalidValueError),
        (lambda m: m.reach(2.0 * np.eye(4)).configuration(), InvalidValueError),
        (lambda m: m.reach([0.0, np.nan, 0.0]).configuration(), InvalidValueError),
    ],
)
def test_arguments_are_checked(five_bar: Robot, call: Callable[[Robot], object], error: type[PM3DofError]) -> None:
    with pytest.raises(error):
        call(five_bar)


def test_what_the_description_lacks_is_named(crank_rocker: Robot) -> None:
    toolless = Robot(crank_rocker.model, crank_rocker.closures, source="little.yaml")
    with pytest.raises(DescriptionError, match=r"little\.yaml: tool_frame"):
        toolless.reach(np.eye(4), guess=crank_rocker.assemble([0.6, 0.8, 1.0, 0.5])).configuration()


def test_another_mechanisms_configuration_is_no_guess(five_bar: Robot, crank_rocker: Robot) -> None:
    with pytest.raises(InvalidValueError):
        five_bar.assemble(crank_rocker.home)


def test_random_loops_close_from_random_guesses() -> None:
    """Two random chains of six revolute joints, welded or pinned at a random assembled configuration."""
    rng = np.random.default_rng(17)
    for trial in range(40):
        kind = "3d" if trial % 2 else "6d"
        mechanism, solution = _random_loop(rng, kind)
        guess = solution + rng.uniform(-0.3, 0.3, len(solution))
        result = assemble(mechanism, guess)
        assert result.converged, f"trial {trial}"
        assert result.residual < 1e-14


def _random_loop(rng: np.random.Generator, kind: str) -> tuple[Robot, np.ndarray]:
    model = pin.Model()
    for branch in ("left", "right"):
        parent = 0
        for depth in range(6):
            placement = pin.SE3(pin.exp3(rng.normal(size=3)), rng.uniform(-0.3, 0.3, 3))
            parent = model.addJoint(parent, pin.JointModelRZ(), placement, f"{branch}{depth}")
        model.addFrame(pin.Frame(f"{branch}_tip", parent, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    solution = rng.uniform(-1.0, 1.0, 12)
    data = model.createData()
    pin.forwardKinematics(model, data, solution)
    left, right = data.oMi[6], data.oMi[12]
    model.frames[model.getFrameId("right_tip")].placement = right.actInv(left)
    closure = LoopClosure("left_tip", "right_tip", "3d" if kind == "3d" else "6d")
    mechanism = Robot(model, [closure])
    assert mechanism.configuration(solution).closure_residual < 1e-14
    return mechanism, solution


def test_a_whole_orientation_is_found_where_its_angles_are_singular() -> None:
    """R = Rx Ry Rz with ry a right angle: only rx + rz is determined."""
    model = pin.Model()
    parent = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "float")
    model.addFrame(pin.Frame("tool", parent, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    robot = Robot(model, tool_frame="tool")
    angles = {"rx": 0.3, "ry": np.pi / 2.0, "rz": 0.2}
    found = assemble(robot, robot.home, tool=angles)
    assert found.converged
    assert found.steps < 20
    turns = [pin.utils.rotate(axis, angle) for axis, angle in zip("xyz", angles.values(), strict=True)]
    np.testing.assert_allclose(found.configuration.tool_placement.rotation, turns[0] @ turns[1] @ turns[2], atol=1e-9)


def test_a_decomposition_that_does_not_converge_is_done_by_iteration(
    open_crank_rocker: Configuration, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As LAPACK's divide and conquer for one of some hundred Jacobians of 64 four-bars, of 192 rows."""

    def fail(*_: Any, **__: Any) -> None:
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr(np.linalg, "svd", fail)
    robot = open_crank_rocker.mechanism
    start = pin.integrate(robot.model, open_crank_rocker.q, np.full(robot.model.nv, 0.1))
    found = assemble(robot, start, joints={"crank_joint": np.pi / 2})
    assert found.converged
    np.testing.assert_allclose(found.q, open_crank_rocker.q, atol=1e-9)
    with pytest.raises(np.linalg.LinAlgError):
        svd(np.full((2, 2), np.nan))
