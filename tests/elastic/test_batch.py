"""Programs of elastic mechanisms against singular values on Pinocchio's Jacobians, and against formulas."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.elastic import indices, shares
from pm3dof_pin.elastic.batch import compliance, evaluate, stiffness
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.free_motions import free_motion_stiffness
from pm3dof_pin.elastic.loaded import loaded_equilibrium
from pm3dof_pin.elastic.loads import Loads
from pm3dof_pin.elastic.quantities import (
    AXIS_COMPLIANCE,
    AXIS_STIFFNESS,
    COMPLIANCE,
    CONDITIONING,
    PRINCIPAL_STIFFNESS,
    free_stiffness,
    spring_shares,
)
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.elastic.springs import AxialSpring, BeamSpring, ClosureSpring, JointSpring, Spring
from pm3dof_pin.elastic.traced import elastic_program
from pm3dof_pin.exceptions import FreeDirectionError
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Engine

MACHINES = Path(__file__).parents[1] / "machines"
IDENTITY = pin.SE3.Identity()
PLANAR = np.ix_([0, 1, 5], [0, 1, 5])


def at(*position: float) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array(position, dtype=float))


def difference(matrices: np.ndarray, expected: np.ndarray, length: float) -> float:
    """Greatest difference, entries measured by their diagonals; rigid directions by the softest over a length."""
    unit = np.repeat([length, 1.0], 3)
    softest = (np.einsum("...ii->...i", expected) / unit**2).max(axis=-1, keepdims=True)
    scale = np.sqrt(np.maximum(np.einsum("...ii->...i", expected), 1e-12 * softest * unit**2))
    return float(np.nanmax(np.abs(matrices - expected) / (scale[..., :, None] * scale[..., None, :])))


def load(name: str) -> ElasticModel:
    known = MACHINES / name / f"{name}.urdf"
    return ElasticModel.load(known if known.exists() else name)


def test_four_bar_through_its_whole_turn() -> None:
    model = load("four_bar")
    poses = model.rigid.solve(np.linspace(-0.6, 0.6, 500)[:, None], on_failure="nan")
    q = poses.q[poses.solved]
    assert len(q) > 250
    found = evaluate(model, q, COMPLIANCE)
    careful = compliance(model, q, engine="pinocchio")
    assert difference(found.values, careful, model.mechanism.characteristic_length) < 1e-10


@pytest.mark.parametrize("engine", ["program", "pinocchio"])
def test_principal_stiffnesses_of_a_planar_machine_are_infinite_across_its_plane(engine: Engine) -> None:
    model = load("five_bar")
    poses = reachable_poses(model.rigid, 5, np.random.default_rng(0))
    C = compliance(model, poses, engine="pinocchio")
    found = evaluate(model, poses, PRINCIPAL_STIFFNESS, engine=engine).values[:, 0]
    in_plane = np.linalg.eigvalsh(np.linalg.inv(C[:, :2, :2]))
    np.testing.assert_allclose(found, np.column_stack([in_plane, np.full(5, np.inf)]), rtol=1e-10)


@pytest.mark.parametrize("engine", ["program", "pinocchio"])
def test_a_tool_on_the_axes_of_a_pan_tilt_is_rigid_but_for_two_rotations(
    rigid_tree: Callable[..., Robot], engine: Engine
) -> None:
    """Its axes are at right angles whatever the pan, so that its principal stiffnesses are those of the springs."""
    robot = rigid_tree(
        [("pan", "universe", IDENTITY, pin.JointModelRZ()), ("tilt", "pan", IDENTITY, pin.JointModelRY())],
        actuated_joints=["pan_joint", "tilt_joint"],
        tool_frame="tilt",
    )
    springs = [JointSpring(f"{n}_spring", f"{n}_joint", k, "N m/rad") for n, k in (("pan", 1e3), ("tilt", 2e3))]
    model, q = ElasticModel(robot, springs), np.array([[0.0, 0.0], [0.3, -0.4]])
    found = evaluate(model, q, PRINCIPAL_STIFFNESS, engine=engine)
    np.testing.assert_array_equal(found.values[:, 0], np.inf)
    np.testing.assert_allclose(found.values[:, 1], [[1e3, 2e3, np.inf]] * 2, rtol=1e-12)
    # the tilt's axis is (-sin pan, cos pan, 0), and springs in series add their compliances along x and y
    s, c = np.sin(0.3), np.cos(0.3)
    felt = [[np.inf] * 4 + [2e3, 1e3], [np.inf] * 3 + [2e3 / s**2, 2e3 / c**2, 1e3]]
    np.testing.assert_allclose(evaluate(model, q, AXIS_STIFFNESS, engine=engine).values, felt, rtol=1e-12)


@pytest.mark.parametrize("engine", ["program", "pinocchio"])
@pytest.mark.parametrize("is_sprung", ["slides", "turns"])
def test_a_free_tool_has_no_conditioning(rigid_tree: Callable[..., Robot], is_sprung: str, engine: Engine) -> None:
    slides = [pin.JointModelPX(), pin.JointModelPY(), pin.JointModelPZ()]
    turns = [pin.JointModelRX(), pin.JointModelRY(), pin.JointModelRZ()]
    names = ["universe", *(f"{kind}{k}" for kind in ("slides", "turns") for k in range(3))]
    parts = zip(names[1:], names, [*slides, *turns], strict=False)
    driven = [f"{is_sprung}{k}_joint" for k in range(3)]
    robot = rigid_tree([(n, p, IDENTITY, j) for n, p, j in parts], actuated_joints=driven, tool_frame="turns2")
    unit = "N/m" if is_sprung == "slides" else "N m/rad"
    model = ElasticModel(robot, [JointSpring(f"{joint}_spring", joint, 1e5, unit) for joint in driven])
    assert np.isnan(evaluate(model, np.full((1, 6), 0.1), CONDITIONING, engine=engine).values).all()


@pytest.mark.parametrize("engine", ["program", "pinocchio"])
def test_a_tool_next_to_the_centre_of_a_wrist_by_rounding_is_rigid_there(
    rigid_tree: Callable[..., Robot], engine: Engine
) -> None:
    """The way there and back leaves 1e-17 m, a compliance of 1e-37 m/N, and shares of rounding."""
    turn = pin.rpy.rpyToMatrix(0.3, -0.7, 1.1)
    away = pin.SE3(turn, np.array([0.11, -0.07, 0.05]))
    back = pin.SE3(np.eye(3), -turn.T @ away.translation)
    joints = [pin.JointModelRX(), pin.JointModelRY(), pin.JointModelRZ()]
    names = ["universe", "a", "b", "c"]
    robot = rigid_tree(
        [
            *((own, parent, IDENTITY, joint) for own, parent, joint in zip(names[1:], names, joints, strict=False)),
            ("elbow", "c", away, None),
            ("centre", "elbow", back, None),
        ],
        actuated_joints=["a_joint", "b_joint", "c_joint"],
        tool_frame="centre",
    )
    springs = [JointSpring(f"{name}_spring", f"{name}_joint", 1e3, "N m/rad") for name in names[1:]]
    model, q = ElasticModel(robot, springs), np.array([[0.0, 0.0, 0.0], [0.3, -0.4, 0.2]])
    assert np.abs(robot.at(q).positions).max() > 0.0
    felt = evaluate(model, q, AXIS_STIFFNESS, engine=engine).values
    np.testing.assert_array_equal(felt[:, :3], np.inf)
    np.testing.assert_allclose(felt[0, 3:], 1e3, rtol=1e-12)  # axes at right angles
    principal = evaluate(model, q, PRINCIPAL_STIFFNESS, engine=engine).values
    np.testing.assert_array_equal(principal[:, 0], np.inf)
    shares = evaluate(model, q, spring_shares(model), engine=engine).values
    assert np.isnan(shares[:, :3]).all()
    np.testing.assert_allclose(shares[0, 3:], np.eye(3), atol=1e-12)


@pytest.mark.parametrize("engine", ["program", "pinocchio"])
def test_a_hexapod_that_is_free_to_turn_has_no_stiffness_there(engine: Engine) -> None:
    """Turned by 90 degrees about its axis it is singular (E. F. Fichter, IJRR 5, 1986): one eigenvalue is zero.

    The stiffness of the other motions changes little nearby, where all of it exists.
    """
    model = load("hexapod")
    poses = model.rigid.solve([[0.0, 0.0, 0.135, 0.0, 0.0, angle] for angle in np.radians([90.0, 89.9])])
    values = evaluate(model, poses, CONDITIONING, engine=engine).values
    np.testing.assert_array_equal(values[:, 0] == 0.0, [True, False])
    np.testing.assert_allclose(values[0, 1:], values[1, 1:], rtol=2e-2)
    components = ("x", "y", "z", "rx", "ry", "rz")
    free, near = evaluate(model, poses, free_stiffness(model, components), engine=engine).values
    np.testing.assert_allclose(free, near, rtol=0.0, atol=2e-2 * np.abs(near).max())
    np.testing.assert_allclose(np.linalg.eigvalsh(free)[0], 0.0, atol=1e-9 * np.abs(free).max())


@pytest.mark.parametrize("name", ["pm3dof", "hexapod", "three_rps", "delta"])
def test_stiffness_is_the_inverse(name: str) -> None:
    model = load(name)
    poses = reachable_poses(model.rigid, 60, np.random.default_rng(2))
    found, careful = stiffness(model, poses), stiffness(model, poses, engine="pinocchio")
    assert difference(found, careful, model.mechanism.characteristic_length) < 1e-10
    np.testing.assert_array_equal(found, np.swapaxes(found, 1, 2))


def test_a_configuration_is_a_pose() -> None:
    """The tool's position moves by C f under a small force, in the equilibrium found by steps."""
    robot = Robot.load("hexapod")
    force = np.array([3.0, -2.0, 5.0, 0.0, 0.0, 0.0])
    loaded = loaded_equilibrium(ElasticModel(robot), robot.home, Loads(wrenches={"O_e": force}))
    C = compliance(robot, robot.home)
    np.testing.assert_allclose((C @ force)[:3], loaded.displacement()[:3], rtol=1e-3)


@pytest.mark.parametrize("name", ["pm3dof", "hexapod", "delta"])
def test_reductions(name: str) -> None:
    """Quantities reduced by programs, against NumPy on the Pinocchio engine's matrices."""
    model = load(name)
    poses = reachable_poses(model.rigid, 40, np.random.default_rng(3))
    matrices = compliance(model, poses, engine="pinocchio")
    given = evaluate(model, poses, AXIS_COMPLIANCE).values
    np.testing.assert_allclose(given, np.einsum("nii->ni", matrices), rtol=1e-11)
    felt = evaluate(model, poses, AXIS_STIFFNESS).values
    np.testing.assert_allclose(felt, indices.axis_stiffness(np.einsum("nii->ni", matrices)), rtol=1e-11)
    principal = evaluate(model, poses, PRINCIPAL_STIFFNESS).values
    for k, motion in enumerate(("translation", "rotation")):
        expected = indices.principal_axes(indices.condensed_stiffness(matrices, motion)).values  # type: ignore[arg-type]
        np.testing.assert_allclose(principal[:, k], expected, rtol=1e-9)
    conditioning = evaluate(model, poses, CONDITIONING).values
    inverse = stiffness(model, poses, engine="pinocchio")
    length = indices.characteristic_length(inverse)
    np.testing.assert_allclose(conditioning[:, 6], length, rtol=1e-10)
    np.testing.assert_allclose(conditioning[:, :6], indices.eigenvalues(inverse, length), rtol=1e-8)
    parts = evaluate(model, poses, spring_shares(model)).values
    for part, q in zip(parts[:10], poses.q[:10], strict=True):
        report = cartesian_compliance(model, q)
        expected = shares.shares(report.contributions[None], np.eye(6))
        np.testing.assert_allclose(part, expected, atol=1e-10)


@pytest.mark.parametrize("name", ["pm3dof", "hexapod", "three_rps", "delta", "five_bar"])
def test_stiffness_of_coordinates(name: str) -> None:
    model = load(name)
    poses = reachable_poses(model.rigid, 30, np.random.default_rng(11))
    found = evaluate(model, poses, free_stiffness(model))
    assert not found.redone.any()
    for matrix, pose in zip(found.values, poses, strict=True):
        expected = free_motion_stiffness(model, pose).stiffness
        size = np.sqrt(expected.diagonal())
        assert (np.abs(matrix - expected) / np.outer(size, size)).max() < 1e-10


@pytest.mark.parametrize("robot", ["hexapod", "pm3dof"])
@pytest.mark.parametrize("factor", [1e-6, 1e6, 1e9])
def test_one_spring_much_stiffer_or_softer(robot: str, factor: float) -> None:
    """The program of the same structure with other springs; its decisions do not depend on the stiffness."""
    described = ElasticModel.load(robot)
    first = next(k for k, spring in enumerate(described.springs) if isinstance(spring, (JointSpring, AxialSpring)))
    springs = list(described.springs)
    springs[first] = type(springs[first])(**{**vars(springs[first]), "stiffness": springs[first].stiffness * factor})  # type: ignore[union-attr]
    model = ElasticModel(described.rigid, springs)
    poses = reachable_poses(model.rigid, 300, np.random.default_rng(4))
    found = evaluate(model, poses, COMPLIANCE)
    assert not found.redone.any()
    careful = compliance(model, poses, engine="pinocchio")
    assert difference(found.values, careful, model.mechanism.characteristic_length) < 1e-10
    inverse = stiffness(model, poses)
    product = inverse @ found.values
    size = np.sqrt(np.einsum("nii->ni", inverse) * np.einsum("nii->ni", found.values))
    assert (np.abs(product - np.eye(6)) / (size[:, :, None] * size[:, None, :])).max() < 1e-7


def test_bushings_in_closures() -> None:
    described = ElasticModel.load("pm3dof")
    generator = np.random.default_rng(5)
    bushings: list[Spring] = []
    for k in range(3):
        root = generator.uniform(-1.0, 1.0, (3, 3)) + 3.0 * np.eye(3)
        bushings.append(ClosureSpring(f"bushing{k}", k, 1e7 * root @ root.T))
    model = ElasticModel(described.rigid, [*described.springs, *bushings])
    poses = reachable_poses(model.rigid, 100, generator)
    found = evaluate(model, poses, COMPLIANCE)
    assert not found.redone.any()
    careful = compliance(model, poses, engine="pinocchio")
    assert difference(found.values, careful, model.mechanism.characteristic_length) < 1e-10


@pytest.mark.parametrize("sprung", [("actuator1",), ("link1", "link2", "link3"), ("passive_leg",)])
def test_branches_without_springs(sprung: tuple[str, ...]) -> None:
    """Only some springs: all else is rigid, the compliance is singular, and no pose is recomputed for that."""
    described = ElasticModel.load("pm3dof")
    chosen = [spring for spring in described.springs if spring.name in sprung] or described.springs[:1]
    model = ElasticModel(described.rigid, chosen)
    poses = reachable_poses(model.rigid, 100, np.random.default_rng(6))
    found = evaluate(model, poses, COMPLIANCE)
    assert not found.redone.any()
    careful = compliance(model, poses, engine="pinocchio")
    assert difference(found.values, careful, model.mechanism.characteristic_length) < 1e-10
    assert np.isnan(stiffness(model, poses)).all()


def planar_parallel(rigid_tree: Callable[..., Robot]) -> tuple[ElasticModel, np.ndarray, np.ndarray, np.ndarray]:
    """A planar 3-RPR machine: a platform on three elastic struts; returns its anchors and stiffnesses too."""
    angles = np.deg2rad([90.0, 210.0, 330.0])
    bases = 0.5 * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(3)])
    heads = 0.12 * np.column_stack([np.cos(angles + 0.4), np.sin(angles + 0.4), np.zeros(3)])
    stiffnesses = np.array([1e6, 2e6, 5e5])
    entries: list[tuple[str, str, pin.SE3, pin.JointModel | None]] = [
        ("slide_x", "universe", IDENTITY, pin.JointModelPX()),
        ("slide_y", "slide_x", IDENTITY, pin.JointModelPY()),
        ("platform", "slide_y", IDENTITY, pin.JointModelRZ()),
    ]
    closures, springs = [], []
    for k in range(3):
        along = heads[k] - bases[k]
        turn = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, np.arctan2(along[1], along[0])), bases[k])
        entries += [
            (f"swing{k}", "universe", turn, pin.JointModelRZ()),
            (f"strut{k}", f"swing{k}", at(float(np.linalg.norm(along)), 0.0, 0.0), pin.JointModelPX()),
            (f"tip{k}", f"strut{k}", IDENTITY, None),
            (f"head{k}", "platform", at(*heads[k]), None),
        ]
        closures.append(LoopClosure(f"tip{k}", f"head{k}", "3d"))
        springs.append(JointSpring(f"strut{k}", f"strut{k}_joint", stiffnesses[k], "N/m"))
    tree = rigid_tree(
        entries, closures=closures, actuated_joints=[f"strut{k}_joint" for k in range(3)], tool_frame="platform"
    )
    return ElasticModel(tree, springs), bases, heads, stiffnesses


def planar_poses(model: ElasticModel, bases: np.ndarray, heads: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """q at poses (x, y, angle) from the geometry alone, shape=(n, 9)."""
    rows = np.zeros((len(poses), 9))
    robot = model.rigid
    for row, (x, y, angle) in zip(rows, poses, strict=True):
        turn = pin.rpy.rpyToMatrix(0.0, 0.0, angle)
        values = {"slide_x_joint": x, "slide_y_joint": y, "platform_joint": angle}
        for k in range(3):
            home, along = heads[k] - bases[k], np.array([x, y, 0.0]) + turn @ heads[k] - bases[k]
            values[f"swing{k}_joint"] = np.arctan2(np.cross(home, along)[2], home @ along)
            values[f"strut{k}_joint"] = np.linalg.norm(along) - np.linalg.norm(home)
        for joint, value in values.items():
            row[robot.single_joint(joint).q_index] = value
    return rows


def strut_rates(bases: np.ndarray, heads: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """J, the rates of the struts against those of (x, y, rz); K = J^T k J."""
    jacobian = np.zeros((3, 3))
    turn = pin.rpy.rpyToMatrix(0.0, 0.0, pose[2])
    for k in range(3):
        arm = turn @ heads[k]
        along = np.array([pose[0], pose[1], 0.0]) + arm - bases[k]
        direction = along / np.linalg.norm(along)
        jacobian[k] = [direction[0], direction[1], np.cross(arm, direction)[2]]
    return jacobian


def planar_compliance(bases: np.ndarray, heads: np.ndarray, stiffnesses: np.ndarray, pose: np.ndarray) -> np.ndarray:
    inverse = np.linalg.inv(strut_rates(bases, heads, pose))
    matrix: np.ndarray = inverse @ np.diag(1.0 / stiffnesses) @ inverse.T
    return matrix


def test_a_tool_that_nothing_holds(tmp_path: Path) -> None:
    """A floating body with a sprung arm: no compliance, and no stiffness to invert for one."""
    path = tmp_path / "afloat.xml"
    path.write_text(
        """<mujoco><worldbody><body name="a"><freejoint/><geom size="0.1" mass="1"/>
        <body name="b"><joint name="j" axis="0 1 0" stiffness="10"/><geom size="0.1" mass="1"/>
        <site name="tcp" pos="0.2 0 0"/></body></body></worldbody></mujoco>"""
    )
    robot = Robot.load(path, tool_frame="tcp")
    poses = robot.at(np.stack([robot.home.q, robot.home.q]))
    for engine in ("program", "pinocchio"):
        with pytest.raises(FreeDirectionError, match="'tcp' moves freely"):
            compliance(robot, poses, engine=engine)


def test_planar_machine_with_redundant_closures(rigid_tree: Callable[..., Robot]) -> None:
    model, bases, heads, stiffnesses = planar_parallel(rigid_tree)
    generator = np.random.default_rng(7)
    poses = generator.uniform([-0.1, -0.1, -0.5], [0.1, 0.1, 0.5], (500, 3))
    q = planar_poses(model, bases, heads, poses)
    found = evaluate(model, q, COMPLIANCE)
    assert not found.redone.any()
    for matrix, pose in zip(found.values, poses, strict=True):
        expected = planar_compliance(bases, heads, stiffnesses, pose)
        np.testing.assert_allclose(matrix[PLANAR], expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())
        assert np.abs(matrix[2:5]).max() < 1e-15 * np.abs(expected).max()


def test_walk_through_a_singular_pose(rigid_tree: Callable[..., Robot]) -> None:
    """All struts meet in one point: the compliance grows without bound, and is right or recomputed."""
    model, bases, heads, stiffnesses = planar_parallel(rigid_tree)

    def determinant(angle: float) -> float:
        return abs(float(np.linalg.det(strut_rates(bases, heads, np.array([0.02, 0.03, angle])))))

    coarse = np.linspace(-2.5, 2.5, 2001)
    lowest = coarse[np.argmin([determinant(angle) for angle in coarse])]
    fine = lowest + np.linspace(-4e-3, 4e-3, 4001)
    singular = fine[np.argmin([determinant(angle) for angle in fine])]
    way = singular + np.concatenate([-np.logspace(-1.5, -9, 60), [0.0], np.logspace(-9, -1.5, 60)])
    poses = np.column_stack([np.full(len(way), 0.02), np.full(len(way), 0.03), way])
    q = planar_poses(model, bases, heads, poses)
    values, sound = elastic_program(model, "platform", "compliance", COMPLIANCE.traced, closed=True).with_doubt(q)
    assert sound.any()
    assert not sound.all()
    for matrix, pose in zip(values.reshape(-1, 6, 6)[sound], poses[sound], strict=True):
        expected = planar_compliance(bases, heads, stiffnesses, pose)
        scale = np.sqrt(np.outer(expected.diagonal(), expected.diagonal()))
        assert (np.abs(matrix[PLANAR] - expected) / scale).max() < 1e-8


def test_twelve_springs_on_redundant_welds(rigid_tree: Callable[..., Robot]) -> None:
    """A plate on three legs of beams, welded: statically indeterminate to degree 12; stiffnesses of the legs add."""
    corners = [at(0.3, 0.0, 0.0), at(-0.2, 0.25, 0.0), at(-0.1, -0.3, 0.05)]
    generator = np.random.default_rng(8)
    entries: list[tuple[str, str, pin.SE3, pin.JointModel | None]] = [
        ("plate", "universe", at(0.0, 0.0, 0.4), pin.JointModelFreeFlyer()),
    ]
    closures: list[LoopClosure] = []
    springs: list[Spring] = []
    expected = np.zeros((6, 6))
    for k, corner in enumerate(corners):
        entries += [
            (f"post{k}", "universe", corner, pin.JointModelRX()),
            (f"top{k}", f"post{k}", at(0.0, 0.0, 0.4), None),
            (f"socket{k}", "plate", corner, None),
        ]
        closures.append(LoopClosure(f"top{k}", f"socket{k}", "6d"))
        root = generator.uniform(-1.0, 1.0, (6, 6)) + 3.0 * np.eye(6)
        matrix = 1e5 * root @ root.T
        springs.append(BeamSpring(f"beam{k}", f"top{k}", matrix))
        # the hinge at the foot of the post is free about x: its motion is projected out of the beam's stiffness
        foot = np.array([0.0, -0.4, 0.0, 1.0, 0.0, 0.0])
        beam = matrix - np.outer(matrix @ foot, matrix @ foot) / (foot @ matrix @ foot)
        expected += _moved(beam, corner.translation)
    tree = rigid_tree(entries, closures=closures, actuated_joints=[], tool_frame="plate")
    model = ElasticModel(tree, springs)
    q = pin.neutral(tree.model)
    assert difference(stiffness(model, q), expected, 0.3) < 1e-11
    assert difference(compliance(model, q), np.linalg.inv(expected), 0.3) < 1e-10


def _moved(matrix: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Return the stiffness at the origin from that at a point, with the same axes."""
    x, y, z = point
    to_point = np.eye(6)
    to_point[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    moved: np.ndarray = to_point.T @ matrix @ to_point
    return moved


def test_other_frames_and_shapes() -> None:
    model = ElasticModel.load("pm3dof")
    poses = reachable_poses(model.rigid, 6, np.random.default_rng(9))
    at_tip = compliance(model, poses.q.reshape(2, 3, -1), frame="E1")
    assert at_tip.shape == (2, 3, 6, 6)
    for matrix, q in zip(at_tip.reshape(-1, 6, 6), poses.q, strict=True):
        expected = cartesian_compliance(model, q, frame="E1").compliance
        assert difference(matrix, expected, model.mechanism.characteristic_length) < 1e-11


def test_results_do_not_depend_on_threads() -> None:
    model = ElasticModel.load("hexapod")
    poses = reachable_poses(model.rigid, 5000, np.random.default_rng(10))
    np.testing.assert_array_equal(compliance(model, poses, threads=1), compliance(model, poses, threads=2))


def test_a_robot_stands_for_its_described_springs() -> None:
    robot = Robot.load("pm3dof")
    poses = reachable_poses(robot, 5, np.random.default_rng(12))
    found = compliance(robot, poses)
    np.testing.assert_array_equal(found, compliance(ElasticModel(robot), poses))
    np.testing.assert_array_equal(found, compliance(robot, poses))
