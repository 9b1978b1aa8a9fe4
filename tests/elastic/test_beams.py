"""Mechanisms of beams against matrix structural analysis of the same frame, implemented here.

Its elements are the usual Euler-Bernoulli beams with 12 displacements, independent of the package.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.elastic.batch import compliance
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.elastic.springs import BeamSpring, CantileverSpring, JointSpring, Spring
from pm3dof_pin.kinematics.robot import Robot

RigidTree = Callable[..., Robot]

EA, EI_Y, EI_Z, GJ = 2.1e7, 900.0, 1500.0, 700.0


def assert_same(matrix: np.ndarray, expected: np.ndarray, tolerance: float = 1e-9) -> None:
    scale = np.sqrt(np.abs(expected.diagonal()))
    assert (np.abs(matrix - expected) / np.outer(scale, scale)).max() < tolerance


def element(length: float) -> np.ndarray:
    """Stiffness of a beam along z from its first to its second end, 12 x 12, in its own axes.

    Bending in the plane z-x is about y, with EI_Y, that in z-y about x, with EI_Z.
    """
    k = np.zeros((12, 12))

    def couple(i: int, j: int, value: float) -> None:
        k[np.ix_([i, j], [i, j])] += value * np.array([[1.0, -1.0], [-1.0, 1.0]])

    couple(2, 8, EA / length)
    couple(5, 11, GJ / length)
    for shift, turn, ei, sign in ((0, 4, EI_Y, 1.0), (1, 3, EI_Z, -1.0)):
        a, b, c, d = shift, turn, shift + 6, turn + 6
        block = (
            ei
            / length**3
            * np.array(
                [
                    [12.0, 6.0 * length, -12.0, 6.0 * length],
                    [6.0 * length, 4.0 * length**2, -6.0 * length, 2.0 * length**2],
                    [-12.0, -6.0 * length, 12.0, -6.0 * length],
                    [6.0 * length, 2.0 * length**2, -6.0 * length, 4.0 * length**2],
                ]
            )
        )
        signs = np.array([1.0, sign, 1.0, sign])
        k[np.ix_([a, b, c, d], [a, b, c, d])] += block * np.outer(signs, signs)
    return k


@dataclass
class Frame:
    """Beams between nodes. A node has six displacements; a hinge gives one of its beams a separate rotation."""

    nodes: list[np.ndarray] = field(default_factory=list)
    entries: list[tuple[np.ndarray, np.ndarray]] = field(default_factory=list)
    count: int = 0

    def node(self, position: np.ndarray) -> np.ndarray:
        """Add a node; return the numbers of its displacements."""
        self.nodes.append(position)
        self.count += 6
        return np.arange(self.count - 6, self.count)

    def hinged(self, numbers: np.ndarray, axis: int) -> np.ndarray:
        """Numbers of a node's displacements with a separate rotation about a world axis."""
        released = numbers.copy()
        released[3 + axis] = self.count
        self.count += 1
        return released

    def beam(self, start: np.ndarray, end: np.ndarray, axes: np.ndarray, length: float) -> None:
        """Add a beam between displacements; the columns of `axes` are its x, y, z in the world."""
        turn = np.kron(np.eye(4), axes)
        self.entries.append((np.concatenate([start, end]), turn @ element(length) @ turn.T))

    def spring(self, number: int, stiffness: float) -> None:
        self.entries.append((np.array([number]), np.array([[stiffness]])))

    def compliance(self, numbers: np.ndarray, fixed: np.ndarray) -> np.ndarray:
        """Displacements `numbers` for unit loads on them, with the displacements `fixed` held."""
        stiffness = np.zeros((self.count, self.count))
        for rows, entry in self.entries:
            stiffness[np.ix_(rows, rows)] += entry
        free = np.setdiff1d(np.arange(self.count), fixed)
        loads = np.zeros((self.count, 6))
        loads[numbers, np.arange(6)] = 1.0
        scale = 1.0 / np.sqrt(stiffness[free, free])
        solved = np.linalg.solve(stiffness[np.ix_(free, free)] * np.outer(scale, scale), scale[:, None] * loads[free])
        displacements = np.zeros((self.count, 6))
        displacements[free] = scale[:, None] * solved
        return displacements[numbers]


def tip_spring(name: str, at: str, length: float) -> BeamSpring:
    return BeamSpring(name, at, element(length)[6:, 6:])


def along(roll: float, pitch: float, yaw: float, length: float) -> tuple[pin.SE3, float]:
    """A beam that starts at the end of another, rotated relative to it."""
    return pin.SE3(pin.rpy.rpyToMatrix(roll, pitch, yaw), np.zeros(3)), length


SPATIAL = [along(0.0, 0.0, 0.0, 0.5), along(0.4, 1.2, -0.3, 0.7), along(-1.3, 0.2, 0.8, 0.3)]


def chain(beams: list[tuple[pin.SE3, float]]) -> tuple[list[tuple[str, str, pin.SE3, None]], list[Spring], Frame]:
    """A chain of beams: frames of a tree on the ground, springs at their ends, and the same as a frame."""
    entries: list[tuple[str, str, pin.SE3, None]] = []
    springs: list[Spring] = []
    frame = Frame()
    where, start = pin.SE3.Identity(), frame.node(np.zeros(3))
    for k, (turn, length) in enumerate(beams):
        step = turn * pin.SE3(np.eye(3), np.array([0.0, 0.0, length]))
        entries.append((f"end{k}", f"end{k - 1}" if k else "universe", step, None))
        springs.append(tip_spring(f"beam{k}", f"end{k}", length))
        where = where * step
        end = frame.node(where.translation)
        frame.beam(start, end, where.rotation, length)
        start = end
    return entries, springs, frame


def test_the_tip_of_one_beam() -> None:
    """The reference itself: deflection and slope of a cantilever's tip from the textbook."""
    _, _, frame = chain([along(0.0, 0.0, 0.0, 0.5)])
    c = frame.compliance(np.arange(6, 12), np.arange(6))
    length = 0.5
    assert c[0, 0] == pytest.approx(length**3 / (3 * EI_Y), rel=1e-12)
    assert c[4, 0] == pytest.approx(length**2 / (2 * EI_Y), rel=1e-12)
    assert c[1, 1] == pytest.approx(length**3 / (3 * EI_Z), rel=1e-12)
    assert c[3, 1] == pytest.approx(-(length**2) / (2 * EI_Z), rel=1e-12)
    assert c[2, 2] == pytest.approx(length / EA, rel=1e-12)
    assert c[5, 5] == pytest.approx(length / GJ, rel=1e-12)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_chain_of_beams_in_space(rigid_tree: RigidTree, count: int) -> None:
    entries, springs, frame = chain(SPATIAL[:count])
    tree = rigid_tree(entries, tool_frame=f"end{count - 1}")
    expected = frame.compliance(np.arange(6 * count, 6 * count + 6), np.arange(6))
    assert_same(cartesian_compliance(ElasticModel(tree, springs), []).compliance, expected)


def test_one_beam_cut_into_many(rigid_tree: RigidTree) -> None:
    beams = [along(0.0, 0.0, 0.0, 0.1)] * 8
    entries, springs, _ = chain(beams)
    _, _, whole = chain([along(0.0, 0.0, 0.0, 0.8)])
    tree = rigid_tree(entries, tool_frame="end7")
    expected = whole.compliance(np.arange(6, 12), np.arange(6))
    assert_same(cartesian_compliance(ElasticModel(tree, springs), []).compliance, expected)


@pytest.mark.parametrize("axis", [(0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.3, -0.5, 0.8), (0.0, 0.0, -1.0)])
@pytest.mark.parametrize("axial", [None, EA])
def test_the_cantilever_spring_is_a_beam_along_its_axis(
    rigid_tree: RigidTree, axis: tuple[float, float, float], axial: float | None
) -> None:
    length, ei = 0.4, 800.0
    axis_array = np.array(axis) / np.linalg.norm(axis)
    tree = rigid_tree([("tip", "universe", pin.SE3.Identity(), None)], tool_frame="tip")
    spring = CantileverSpring("beam", "tip", axis, ei, GJ, length, axial)
    along_axis = np.outer(axis_array, axis_array)
    across, cross = np.eye(3) - along_axis, pin.skew(axis_array)
    expected = np.zeros((6, 6))
    expected[:3, :3] = length**3 / (3 * ei) * across + (length / EA * along_axis if axial else 0.0)
    expected[3:, 3:] = length / ei * across + length / GJ * along_axis
    # a force f at the tip turns it about axis x f
    expected[3:, :3] = length**2 / (2 * ei) * cross
    expected[:3, 3:] = expected[3:, :3].T
    result = cartesian_compliance(ElasticModel(tree, [spring]), [])
    np.testing.assert_allclose(result.compliance, expected, atol=1e-15)
    assert result.exists == (axial is not None)


Portal = tuple[ElasticModel, np.ndarray]


def portal(
    rigid_tree: RigidTree, feet: tuple[float, float], hinge: int | None = None, motor: float | None = None
) -> Portal:
    """Two columns with clamped feet of different depth, a beam across with the tool at its middle; a weld closes it.

    At the top of the left column sits a joint about y: a motor, locked or with a spring; `hinge` puts a passive hinge
    about x, y or z (0, 1, 2) at the top of the right column. Also returned: the tool's compliance as a frame of beams.
    """
    half, (left, right) = 0.6, feet
    nodes = np.array([[0, 0, 0], [0, 0, left], [half, 0, left], [2 * half, 0, left], [2 * half, 0, left - right]])
    axes = [np.eye(3), *[pin.rpy.rpyToMatrix(0.0, np.pi / 2, 0.0)] * 2, pin.rpy.rpyToMatrix(np.pi, 0.0, 0.0)]
    lengths = [left, half, half, right]
    ends = [pin.SE3(axes[k], nodes[k + 1]) for k in range(4)]

    joints = [pin.JointModelRX(), pin.JointModelRY(), pin.JointModelRZ()]
    corner = ends[2].actInv(pin.SE3(np.eye(3), nodes[3]))
    entries = [
        ("end0", "universe", ends[0], None),
        ("motor", "end0", ends[0].actInv(pin.SE3(np.eye(3), nodes[1])), pin.JointModelRY()),
        ("end1", "motor", pin.SE3(np.eye(3), nodes[1]).actInv(ends[1]), None),
        ("end2", "end1", ends[1].actInv(ends[2]), None),
        ("corner", "end2", corner, None if hinge is None else joints[hinge]),
        ("end3", "corner", pin.SE3(np.eye(3), nodes[3]).actInv(ends[3]), None),
        ("foot", "universe", ends[3], None),
    ]
    springs: list[Spring] = [tip_spring(f"beam{k}", f"end{k}", length) for k, length in enumerate(lengths)]
    if motor is not None:
        springs.append(JointSpring("motor", "motor_joint", motor, "N m/rad"))
    tree = rigid_tree(
        entries, closures=[LoopClosure("end3", "foot", "6d")], actuated_joints=["motor_joint"], tool_frame="end1"
    )

    frame = Frame()
    numbers = [frame.node(node) for node in nodes]
    starts = list(numbers[:4])
    if motor is not None:
        starts[1] = frame.hinged(numbers[1], 1)
        frame.entries.append((np.array([numbers[1][4], starts[1][4]]), motor * np.array([[1.0, -1.0], [-1.0, 1.0]])))
    if hinge is not None:
        starts[3] = frame.hinged(numbers[3], hinge)
    for k in range(4):
        frame.beam(starts[k], numbers[k + 1], axes[k], lengths[k])
    return ElasticModel(tree, springs), frame.compliance(numbers[2], np.concatenate([numbers[0], numbers[4]]))


@pytest.mark.parametrize("feet", [(0.5, 0.5), (0.4, 0.9)])
@pytest.mark.parametrize("hinge", [None, 0, 1, 2])
@pytest.mark.parametrize("motor", [None, 2e3])
def test_a_portal_closed_by_a_weld(
    rigid_tree: RigidTree, feet: tuple[float, float], hinge: int | None, motor: float | None
) -> None:
    """Six times statically indeterminate, less one for each hinge."""
    model, expected = portal(rigid_tree, feet, hinge, motor)
    q = np.zeros(model.rigid.model.nq)
    is_compiled = (motor is None) == (feet[0] == feet[1])  # each kind of portal compiles programs of its own
    result = cartesian_compliance(model, q)
    assert result.motions.relation_rank.rank == (6 if hinge is None else 5)
    assert_same(result.compliance, expected)
    assert_same(result.stiffness, np.linalg.inv(expected))
    if is_compiled:
        assert_same(compliance(model, [q])[0], expected)


@pytest.mark.parametrize("crank", [0.4, 0.9, 1.7])
def test_a_four_bar_of_beams_overconstrained_in_space(rigid_tree: RigidTree, crank: float) -> None:
    """Three beams on four parallel hinges about z, the last one closed by a weld; a motor's spring at the first.

    As a planar linkage it is exactly constrained, in space it has three redundant constraints. The beams lie in the
    plane, with their bending in and out of it; the tool is at the coupler's far end.
    """
    ground, lengths, motor = 0.5, (0.3, 0.6, 0.4), 3e3
    tree, springs = _four_bar(rigid_tree, ground, lengths, motor)
    where = tree.assemble([crank, 0.6 - crank, 1.5, 0.0], joints={"crank_joint": crank})
    points = [np.zeros(3)]
    points += [where.frame_placement(name).translation for name in ("crank_end", "coupler_end")]
    points.append(np.array([ground, 0.0, 0.0]))

    frame = Frame()
    first, second, third, last = (frame.node(point) for point in points)
    motor_end = frame.hinged(first, 2)
    frame.spring(int(motor_end[5]), motor)
    axes = [where.frame_placement(name).rotation for name in ("crank_end", "coupler_end", "rocker_end")]
    frame.beam(motor_end, second, axes[0], lengths[0])
    frame.beam(frame.hinged(second, 2), third, axes[1], lengths[1])
    rocker_start = frame.hinged(last, 2)
    frame.beam(rocker_start, frame.hinged(third, 2), axes[2], lengths[2])
    expected = frame.compliance(third, np.concatenate([first, last]))

    model = ElasticModel(tree, springs)
    result = cartesian_compliance(model, where)
    assert result.motions.redundant_constraints == 0
    assert_same(result.compliance, expected)
    assert_same(compliance(model, [where.q])[0], expected)


def _four_bar(
    rigid_tree: RigidTree, ground: float, lengths: tuple[float, float, float], motor: float
) -> tuple[Robot, list[Spring]]:
    hinge, lay = pin.JointModelRZ, pin.rpy.rpyToMatrix(0.0, np.pi / 2, 0.0)
    ends = [pin.SE3(lay, np.array([length, 0.0, 0.0])) for length in lengths]
    back = pin.SE3(lay.T, np.zeros(3))
    entries = [
        ("crank", "universe", pin.SE3.Identity(), hinge()),
        ("crank_end", "crank", ends[0], None),
        ("coupler", "crank_end", back, hinge()),
        ("coupler_end", "coupler", ends[1], None),
        ("rocker", "universe", pin.SE3(np.eye(3), np.array([ground, 0.0, 0.0])), hinge()),
        ("rocker_end", "rocker", ends[2], None),
        ("pin", "rocker_end", back, hinge()),
        ("pin_end", "pin", pin.SE3(lay, np.zeros(3)), None),
    ]
    tree = rigid_tree(
        entries,
        closures=[LoopClosure("coupler_end", "pin_end", "6d")],
        actuated_joints=["crank_joint"],
        tool_frame="coupler_end",
    )
    springs: list[Spring] = [JointSpring("motor", "crank_joint", motor, "N m/rad")]
    names = ("crank", "coupler", "rocker")
    springs += [tip_spring(name, f"{name}_end", length) for name, length in zip(names, lengths, strict=True)]
    return tree, springs
