"""Rods that spin between two balls, as most models of deltas have: poses end where the machine is singular.

Their spin belongs to no equation. What is left has determinants, whose signs are compared with those of closed forms.
"""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.kinematics.jacobian_programs import bound_jacobian
from pm3dof_pin.kinematics.jacobians import motion_rates
from pm3dof_pin.kinematics.robot import Robot

Z = np.array([0.0, 0.0, 1.0])


def crank_and_rocker(seed: int, off_axis: float | None = None) -> tuple[Robot, tuple[np.ndarray, ...]]:
    """Return a crank and a rocker about skew axes, joined by a rod between balls; and axis, point and end of both.

    The rod has the axes of the base, or its z axis runs through its end up to an angle `off_axis` [rad].
    """
    draw = np.random.default_rng(seed).normal
    axes = [axis / np.linalg.norm(axis) for axis in draw(size=(2, 3))]
    points = 0.1 * draw(size=(2, 3)) + [[0.0, 0.0, 0.0], [0.4, 0.0, 0.0]]
    ends = points + 0.2 * draw(size=(2, 3))
    model = pin.Model()
    for name, axis, point in zip(("crank", "rocker"), axes, points, strict=True):
        model.addJoint(0, pin.JointModelRevoluteUnaligned(axis), pin.SE3(np.eye(3), point), name)
    turn = np.eye(3)
    if off_axis is not None:
        turn = Rotation.align_vectors([ends[1] - ends[0]], [[off_axis, 0.0, 1.0]])[0].as_matrix()
    rod = model.addJoint(1, pin.JointModelSpherical(), pin.SE3(turn, ends[0] - points[0]), "ball")
    for name, joint, place in (("rod_end", rod, turn.T @ (ends[1] - ends[0])), ("rocker_end", 2, ends[1] - points[1])):
        model.addFrame(pin.Frame(name, joint, pin.SE3(np.eye(3), place), pin.FrameType.OP_FRAME))
    robot = Robot(
        model, [LoopClosure("rod_end", "rocker_end", "3d")], actuated_joints=["crank"], tool_frame="rocker_end"
    )
    return robot, (axes[0], points[0], ends[0], axes[1], points[1], ends[1])


def rocker_angles(machine: tuple[np.ndarray, ...], crank: np.ndarray) -> np.ndarray:
    """Return the two angles at which the rod has its length, shape=(n, 2); NaN where it has it at none."""
    axis, point, end, other, pivot, tip = machine
    from_pivot = Rotation.from_rotvec(crank[:, None] * axis).apply(end - point) + point - pivot
    arm = tip - pivot
    along = other * (other @ arm)
    u = from_pivot - along
    a, b = -2.0 * u @ (arm - along), -2.0 * u @ np.cross(other, arm)
    c = np.sum((end - tip) ** 2) - np.sum(u**2, axis=1) - np.sum((arm - along) ** 2)
    with np.errstate(invalid="ignore"):
        spread = np.arccos(c / np.hypot(a, b))
    middle = np.arctan2(b, a)
    return np.stack([middle + spread, middle - spread], axis=1)


@pytest.mark.parametrize(
    ("seed", "engine"), [*((seed, "program") for seed in (4, 8, 21, 41, 46)), (21, "pinocchio"), (46, "pinocchio")]
)
def test_a_rocker_stays_on_its_side_of_the_dead_points(seed: int, engine: str) -> None:
    robot, machine = crank_and_rocker(seed)
    step, middle = (1.0, 179) if engine == "program" else (4.0, 44)
    crank = np.radians(step * np.arange(-middle, middle + 1))
    angles = np.angle(np.exp(1j * rocker_angles(machine, crank)))
    side = int(np.argmin(np.abs(angles[middle])))  # at home both joints are at zero
    reachable = np.isfinite(angles[:, 0])
    first, last = (middle - np.argmin(reachable[middle::-1]), middle + np.argmin(reachable[middle:]))
    inside = np.zeros(len(crank), dtype=bool)
    inside[0 if reachable[: middle + 1].all() else first + 1 : None if reachable[middle:].all() else last] = True
    guess = None if engine == "program" else robot.home  # then no waypoints are tried, which take long
    poses = robot.forward(crank[:, None], guess=guess, on_failure="nan", engine=engine)
    rocker = poses.q[:, robot.single_joint("rocker").q_index]
    np.testing.assert_array_equal(poses.solved[inside], True)
    found = np.flatnonzero(poses.solved)
    np.testing.assert_allclose(np.exp(1j * rocker[found]), np.exp(1j * angles[found, side]), atol=1e-7)


@pytest.mark.parametrize("off_axis", [0.0, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4])
def test_an_axis_that_is_rounded_puts_no_jacobian_in_doubt(off_axis: float) -> None:
    """A rod of CAD runs along its own axis up to rounding: its spin about it then nearly leaves the loop as it is."""
    robot, machine = crank_and_rocker(8, off_axis)
    crank = np.radians(np.linspace(-5.0, 5.0, 101))
    poses = robot.forward(crank[:, None])
    rates = [motion_rates(robot, "of", [name]) for name in ("rocker", "crank")]
    values, sound = bound_jacobian(robot, *rates, with_derivatives=False).with_doubt(poses.q)
    assert sound.all()
    angles = [rocker_angles(machine, crank + step) for step in (-1e-5, 1e-5)]
    side = int(np.argmin(np.abs(rocker_angles(machine, np.zeros(1))[0])))
    expected = (angles[1] - angles[0])[:, side] / 2e-5
    np.testing.assert_allclose(values[:, 0], expected, rtol=1e-7)


class RotaryDelta:
    """A delta of three arms that turn, each with two rods between balls."""

    def __init__(self, seed: int) -> None:
        draw = np.random.default_rng(seed).uniform
        base, self.arm, self.height, self.drop = draw([0.1, 0.12, 0.3, -0.3], [0.2, 0.3, 0.5, 0.9])
        angles = 0.3 + 2.0 * np.pi * np.arange(3) / 3.0
        self.outwards = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(3)])
        self.sideways = np.column_stack([-np.sin(angles), np.cos(angles), np.zeros(3)])
        self.hips, self.balls = base * self.outwards, 0.04 * self.outwards
        self.home = -self.height * Z
        self.rod = float(np.linalg.norm(self.home + self.balls[0] - self.knees(np.zeros(3))[0]))

    def knees(self, turns: np.ndarray) -> np.ndarray:
        angles = self.drop + turns[:, None]
        return self.hips + self.arm * (np.cos(angles) * self.outwards - np.sin(angles) * Z)

    def tool(self, turns: np.ndarray) -> np.ndarray | None:
        """Return the tool below the knees, or where it is at home, by three spheres."""
        a, b, c = self.knees(turns) - self.balls
        first = (b - a) / np.linalg.norm(b - a)
        i = first @ (c - a)
        second = (c - a - i * first) / np.linalg.norm(c - a - i * first)
        x = 0.5 * np.linalg.norm(b - a)
        y = 0.5 * ((c - a) @ (c - a)) / (second @ (c - a)) - i / (second @ (c - a)) * x
        square = self.rod**2 - x**2 - y**2
        up = np.cross(first, second) if self.is_above else -np.cross(first, second)
        return a + x * first + y * second + np.sqrt(square) * up if square > 0.0 else None

    @property
    def is_above(self) -> bool:
        a, b, c = self.knees(np.zeros(3)) - self.balls
        return bool(np.cross(b - a, c - a) @ (self.home - a) > 0.0)

    def determinant(self, turns: np.ndarray, tool: np.ndarray) -> float:
        """Return that of the platform's twist by the six lengths of rods, up to positive factors.

        Sums of the two rows of an arm have its rod r alone, differences the turn about its sideways axis s times r.
        """
        rods = tool + self.balls - self.knees(turns)
        return float(np.linalg.det(rods) * np.linalg.det(np.cross(self.sideways, rods)))

    def robot(self) -> Robot:
        model, at = pin.Model(), lambda place: pin.SE3(np.eye(3), np.asarray(place))
        joint = model.addJoint(0, pin.JointModelTranslation(), at(self.home), "place")
        platform = model.addJoint(joint, pin.JointModelSpherical(), at(np.zeros(3)), "turn")
        model.addFrame(pin.Frame("tool", platform, at(np.zeros(3)), pin.FrameType.OP_FRAME))
        closures = []
        for k, (hip, knee) in enumerate(zip(self.hips, self.knees(np.zeros(3)), strict=True)):
            axis = pin.JointModelRevoluteUnaligned(self.sideways[k])
            arm = model.addJoint(0, axis, at(hip), f"arm{k}")
            for side in (-1, 1):
                shift, name = 0.02 * side * self.sideways[k], f"rod{k}{'ab'[side > 0]}"
                rod = model.addJoint(arm, pin.JointModelSpherical(), at(knee - hip + shift), name)
                end = self.home + self.balls[k] - knee
                model.addFrame(pin.Frame(f"{name}_end", rod, at(end), pin.FrameType.OP_FRAME))
                model.addFrame(pin.Frame(f"{name}_ball", platform, at(self.balls[k] + shift), pin.FrameType.OP_FRAME))
                closures.append(LoopClosure(f"{name}_end", f"{name}_ball", "3d"))
        arms = [f"arm{k}" for k in range(3)]
        drives = [Coordinate(f"u{k}", "rad", joint=name) for k, name in enumerate(arms)]
        return Robot(model, closures, actuated_joints=arms, tool_frame="tool", coordinates=drives)


@pytest.mark.parametrize(
    ("seed", "engine", "count"),
    [(8, "program", 400), (12, "program", 400), (20, "program", 400), (20, "pinocchio", 15)],
)
def test_a_delta_ends_at_its_singular_poses(seed: int, engine: str, count: int) -> None:
    """Beyond them its platform could turn, and a third branch begins there, on which it does."""
    delta = RotaryDelta(seed)
    robot = delta.robot()
    assert math.isclose(robot.home.closure_residual, 0.0, abs_tol=1e-14)
    turns = np.random.default_rng(seed).uniform(-1.6, 1.6, (count, 3))
    guess = None if engine == "program" else robot.home
    poses = robot.forward(turns, guess=guess, on_failure="nan", engine=engine)
    at_home = delta.determinant(np.zeros(3), delta.home) > 0.0
    places = [delta.tool(row) for row in turns]
    same = np.array(
        [p is not None and (delta.determinant(t, p) > 0.0) == at_home for t, p in zip(turns, places, strict=True)]
    )
    assert 0.2 < same.mean() < 0.95
    assert not poses.solved[~same].any()
    assert poses.solved[same].mean() > 0.85  # others on the same side cannot be reached from home
    expected = np.array([np.full(3, np.nan) if place is None else place for place in places])
    np.testing.assert_allclose(poses.positions[poses.solved], expected[poses.solved], atol=1e-9)
    tilts = poses.rotations[poses.solved] - np.eye(3)
    np.testing.assert_allclose(tilts, np.zeros_like(tilts), atol=1e-7)
