"""The general engine against the closed form, minimised energies, the full linear system and serial arms."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.elastic_stiffness import contribution_names, elastic_stiffness, spring_contributions
from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.elastic.batch import compliance
from pm3dof_pin.elastic.definite_inverse import inverse_definite
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.elastic.springs import AxialSpring, BeamSpring, ClosureSpring, JointSpring, Spring
from pm3dof_pin.exceptions import (
    FrameNotFoundError,
    FreeDirectionError,
    InvalidValueError,
    RigidDirectionError,
    SingularConfigurationError,
)
from pm3dof_pin.kinematics.robot import Robot

POSE = np.array([0.25, -0.3, 0.48])
IDENTITY = pin.SE3.Identity()


def assert_same(matrix: np.ndarray, expected: np.ndarray, tolerance: float) -> None:
    """Compare entry by entry with the geometric mean of the two diagonal entries, whatever their units."""
    scale = np.sqrt(np.einsum("...ii->...i", expected))
    difference = np.abs(matrix - expected) / (scale[..., :, None] * scale[..., None, :])
    assert difference.max() < tolerance


def at(*position: float) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array(position, dtype=float))


# --- the tripod: closed form and energy


def test_general_engine_is_the_closed_form_all_over_the_workspace(
    tripod: Tripod,
    elastic: ElasticModel,
    reachable_poses: np.ndarray,
    tripod_positions: Callable[[np.ndarray], np.ndarray],
) -> None:
    compliances = compliance(elastic, tripod_positions(reachable_poses[:2000]))
    assert_same(inverse_definite(compliances), elastic_stiffness(tripod, reachable_poses[:2000]), 1e-11)


def test_one_pose_is_the_closed_form(
    tripod: Tripod, elastic: ElasticModel, tripod_positions: Callable[[np.ndarray], np.ndarray]
) -> None:
    (q,) = tripod_positions(POSE[None])
    result = cartesian_compliance(elastic, q)
    expected = elastic_stiffness(tripod, POSE)
    assert result.exists
    assert_same(result.stiffness, expected, 1e-12)
    assert_same(result.compliance, np.linalg.inv(expected), 1e-11)
    np.testing.assert_array_equal(result.stiffness, result.stiffness.T)
    np.testing.assert_array_equal(result.compliance, result.compliance.T)
    parts = dict(zip(contribution_names(tripod), spring_contributions(tripod, POSE), strict=True))
    for name, part in zip(result.spring_names, result.contributions, strict=True):
        scale = np.sqrt(result.compliance.diagonal())
        assert np.abs((part - parts[name]) / np.outer(scale, scale)).max() < 1e-11


class TripodEnergy:
    """Explicit energy of the nonlinear tripod with held platform, minimised over the springs, without Jacobians."""

    def __init__(self, tripod: Tripod, pose: np.ndarray) -> None:
        p = tripod.parameters
        self.base, self.guides = tripod.base_joints, tripod.guide_directions
        self.joints, self.length = np.array(tripod.platform_joints), p.link_length
        self.clamp = tripod.clamp_height
        self.pose = pose
        self.rotation = Rotation.from_euler("XYZ", [pose[0], pose[1], 0.0])
        joints = self.rotation.apply(self.joints) + np.array([0.0, 0.0, pose[2]])
        across = joints - self.base
        along = np.sum(across * self.guides, axis=1)
        self.travel = along - np.sqrt(along**2 - np.sum(across**2, axis=1) + self.length**2)
        self.roots = np.sqrt([p.actuator_stiffness, p.link_stiffness])
        self.bending, self.torsion = p.bending_stiffness, p.torsional_stiffness

    def deflections(self, unknowns: np.ndarray, moved: np.ndarray) -> np.ndarray:
        """Springs' deflections times the roots of their stiffnesses, for a platform moved by (x, rotation vector)."""
        position = np.array([0.0, 0.0, self.pose[2]]) + moved[:3]
        rotation = Rotation.from_rotvec(moved[3:]) * self.rotation
        slides, (first, second) = unknowns[:3], self.pose[:2] + unknowns[3:]
        sliders = self.base + (self.travel + slides)[:, None] * self.guides
        stretch = np.linalg.norm(rotation.apply(self.joints) + position - sliders, axis=1) - self.length
        tip = rotation * Rotation.from_euler("XYZ", [first, second, 0.0]).inv()
        length = position[2] - self.clamp
        bend = np.concatenate([position[:2], tip.as_euler("XYZ")])
        return np.concatenate([self.roots[0] * slides, self.roots[1] * stretch, self._root(length) @ bend])

    def _root(self, length: float) -> np.ndarray:
        """A root of the stiffness of the cantilever's tip over (x, y, rx, ry, rz), from its compliance."""
        c = np.zeros((5, 5))
        c[0, 0] = c[1, 1] = length**3 / (3.0 * self.bending)
        c[2, 2] = c[3, 3] = length / self.bending
        c[4, 4] = length / self.torsion
        c[0, 3] = c[3, 0] = length**2 / (2.0 * self.bending)
        c[1, 2] = c[2, 1] = -(length**2) / (2.0 * self.bending)
        return np.linalg.inv(np.linalg.cholesky(c))

    def minimum(self, moved: np.ndarray) -> float:
        start = np.zeros(5)
        found = least_squares(
            self.deflections, start, args=(moved,), method="lm", x_scale=[1e-4] * 3 + [1e-2] * 2, xtol=1e-15, ftol=1e-15
        )
        return 0.5 * float(found.fun @ found.fun)

    def hessian(self, steps: np.ndarray) -> np.ndarray:
        hessian = np.empty((6, 6))
        for i in range(6):
            for j in range(i + 1):
                a, b = steps[i] * np.eye(6)[i], steps[j] * np.eye(6)[j]
                # the energy vanishes where the two steps cancel
                signs = [(s, t) for s in (1, -1) for t in (1, -1) if i != j or s == t]
                corners = [self.minimum(s * a + t * b) * s * t for s, t in signs]
                hessian[i, j] = hessian[j, i] = sum(corners) / (4.0 * steps[i] * steps[j])
        return hessian


def test_both_are_the_second_derivative_of_the_minimised_energy(
    tripod: Tripod,
    elastic: ElasticModel,
    tripod_positions: Callable[[np.ndarray], np.ndarray],
) -> None:
    energy = TripodEnergy(tripod, POSE)
    steps = np.array([2e-5, 2e-5, 1e-6, 2e-5, 2e-5, 2e-4])
    # two step sizes, to eliminate the second-order error
    expected = (4.0 * energy.hessian(steps) - energy.hessian(2.0 * steps)) / 3.0
    (q,) = tripod_positions(POSE[None])
    assert_same(cartesian_compliance(elastic, q).stiffness, expected, 1e-8)
    assert_same(elastic_stiffness(tripod, POSE), expected, 1e-8)


# --- the full linear system


def full_system(model: ElasticModel, q: np.ndarray, closure_compliance: np.ndarray | None = None) -> np.ndarray:
    """Solve [K G^T; G -C_c] directly for unit wrenches at the tool."""
    where = model.configuration(q)
    stiffness, closures, jacobian = model.joint_stiffness(where), where.constraint_jacobian, where.tool_jacobian
    free = np.setdiff1d(np.arange(len(stiffness)), model.locked_indices)
    count, rows = len(free), len(closures)
    system = np.zeros((count + rows, count + rows))
    system[:count, :count] = stiffness[np.ix_(free, free)]
    system[count:, :count], system[:count, count:] = closures[:, free], closures[:, free].T
    if closure_compliance is not None:
        system[count:, count:] = -closure_compliance
    scale = 1.0 / np.sqrt(np.abs(system).max(axis=0))
    scale = np.where(np.arange(count + rows) < count, scale, 1.0 / (scale[:count].max() + 0.0))
    loads = np.vstack([jacobian[:, free].T, np.zeros((rows, 6))])
    solved = scale[:, None] * np.linalg.solve(system * np.outer(scale, scale), scale[:, None] * loads)
    return jacobian[:, free] @ solved[:count]


def test_the_full_system_gives_the_same(elastic: ElasticModel, tripod_positions: Callable[..., np.ndarray]) -> None:
    (q,) = tripod_positions(POSE[None])
    assert_same(cartesian_compliance(elastic, q).compliance, full_system(elastic, q), 1e-6)


def test_closures_that_give_are_the_compliance_of_the_full_system(
    mechanism: Robot, elastic: ElasticModel, tripod_positions: Callable[..., np.ndarray]
) -> None:
    """Bushings in all three spherical joints, stiffer along one axis, against -C_c in the lower right block."""
    (q,) = tripod_positions(POSE[None])
    generator = np.random.default_rng(5)
    bushings: list[Spring] = []
    compliance = np.zeros((9, 9))
    for k in range(3):
        root = generator.uniform(-1.0, 1.0, (3, 3)) + 3.0 * np.eye(3)
        matrix = 1e7 * root @ root.T
        bushings.append(ClosureSpring(f"bushing{k}", k, matrix))
        compliance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = np.linalg.inv(matrix)
    soft = ElasticModel(mechanism, [*elastic.springs, *bushings])
    assert_same(cartesian_compliance(soft, q).compliance, full_system(elastic, q, compliance), 1e-6)


def test_a_weld_that_gives(rigid_tree: Callable[..., Robot]) -> None:
    """A body held to the ground by two elastic welds: their stiffnesses, moved to the tool, add."""
    one, two = at(0.3, 0.1, 0.2), pin.SE3(pin.rpy.rpyToMatrix(0.2, 0.5, -0.4), np.array([-0.2, 0.4, 0.1]))
    body = [
        ("ground_one", "universe", one, None),
        ("ground_two", "universe", two, None),
        ("body", "universe", IDENTITY, pin.JointModelFreeFlyer()),
        ("body_one", "body", one, None),
        ("body_two", "body", two, None),
    ]
    welds = [LoopClosure(f"ground_{name}", f"body_{name}", "6d") for name in ("one", "two")]
    tree = rigid_tree(body, closures=welds, tool_frame="body")
    generator = np.random.default_rng(6)
    expected = np.zeros((6, 6))
    springs = []
    for k, place in enumerate((one, two)):
        root = generator.uniform(-1.0, 1.0, (6, 6)) + 3.0 * np.eye(6)
        matrix = 1e6 * root @ root.T
        springs.append(ClosureSpring(f"weld{k}", k, matrix))
        to_place = place.inverse().action
        expected += to_place.T @ matrix @ to_place
    model = ElasticModel(tree, springs)
    assert_same(cartesian_compliance(model, pin.neutral(tree.model)).stiffness, expected, 1e-12)


# --- serial robots


@pytest.fixture(scope="module")
def arm() -> Robot:
    import example_robot_data

    return Robot(example_robot_data.load("ur5").model, tool_frame="tool0")


def test_a_serial_arm_with_joint_springs(arm: Robot) -> None:
    """C = J diag(1/k) J^T, with Pinocchio's own Jacobian."""
    stiffnesses = np.array([38e3, 38e3, 30e3, 8e3, 7e3, 6e3])
    springs = [
        JointSpring(f"gear{k}", joint, stiffnesses[k], "N m/rad") for k, joint in enumerate(list(arm.model.names)[1:])
    ]
    model, data = ElasticModel(arm, springs), arm.model.createData()
    generator = np.random.default_rng(7)
    positions = generator.uniform(-2.0, 2.0, (50, 6))
    swept = compliance(model, positions)
    for q, matrix in zip(positions, swept, strict=True):
        frame = arm.model.getFrameId("tool0")
        jacobian = pin.computeFrameJacobian(arm.model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)
        expected = jacobian @ np.diag(1.0 / stiffnesses) @ jacobian.T
        assert_same(cartesian_compliance(model, q).compliance, expected, 1e-13)
        assert_same(matrix, expected, 1e-13)


def test_joints_of_an_arm_without_a_spring_are_locked(arm: Robot) -> None:
    springs = [JointSpring("elbow", "elbow_joint", 100.0, "N m/rad")]
    result = cartesian_compliance(ElasticModel(arm, springs), np.full(6, 0.3))
    assert result.rigid_directions.shape == (6, 5)
    assert np.linalg.matrix_rank(result.compliance, tol=1e-9) == 1


# --- free and rigid directions


def pendulum(rigid_tree: Callable[..., Robot]) -> Robot:
    """A boom on a driven joint about z, with a passive joint about y at its end and an arm that carries the tool."""
    return rigid_tree(
        [
            ("boom", "universe", IDENTITY, pin.JointModelRZ()),
            ("arm", "boom", at(1.0, 0.0, 0.0), pin.JointModelRY()),
            ("tool", "arm", at(0.0, 0.0, -0.5), None),
            ("hinge", "boom", at(1.0, 0.0, 0.0), None),
        ],
        actuated_joints=["boom_joint"],
        tool_frame="tool",
    )


def test_a_free_direction_is_named(rigid_tree: Callable[..., Robot]) -> None:
    model = ElasticModel(pendulum(rigid_tree), [BeamSpring("boom", "arm_joint", np.eye(6) * 1e4)])
    result = cartesian_compliance(model, [0.0, 0.0], frame="arm")
    assert not result.exists
    with pytest.raises(FreeDirectionError, match=r"'arm'.*rotation about \(-?0, -?1, -?0\)"):
        _ = result.compliance
    expected = np.diag([1e4, 1e4, 1e4, 1e4, 0.0, 1e4])
    np.testing.assert_allclose(result.stiffness, expected, atol=1e-8)
    with pytest.raises(SingularConfigurationError, match="with translation"):
        _ = cartesian_compliance(model, [0.0, 0.0]).compliance
    with pytest.raises(FreeDirectionError):
        compliance(model, [[0.0, 0.0], [0.1, 0.1]])
    assert np.isnan(compliance(model, [[0.0, 0.0], [0.1, 0.1]], on_failure="nan")).all()


def test_a_rigid_direction_is_named(rigid_tree: Callable[..., Robot]) -> None:
    tree = rigid_tree([("tip", "universe", IDENTITY, None)], tool_frame="tip")
    result = cartesian_compliance(ElasticModel(tree, [AxialSpring("bar", "tip", (0, 0, 1), 50.0)]), [])
    np.testing.assert_allclose(result.compliance, np.diag([0, 0, 0.02, 0, 0, 0]), atol=1e-17)
    with pytest.raises(RigidDirectionError, match="translation along") as caught:
        _ = result.stiffness
    assert "rotation about" in str(caught.value)
    assert result.rigid_directions.shape == (6, 5)


def test_free_and_rigid_at_once(rigid_tree: Callable[..., Robot]) -> None:
    """A passive prismatic joint with a spring across it, next to a motor: neither matrix exists, as both say."""
    tree = rigid_tree(
        [
            ("motor", "universe", IDENTITY, pin.JointModelRZ()),
            ("slide", "universe", IDENTITY, pin.JointModelPX()),
            ("tip", "slide", IDENTITY, None),
        ],
        actuated_joints=["motor_joint"],
        tool_frame="tip",
    )
    result = cartesian_compliance(ElasticModel(tree, [AxialSpring("bar", "tip", (0, 1, 0), 50.0)]), [0.0, 0.0])
    assert (result.free_directions.shape, result.rigid_directions.shape) == ((6, 1), (6, 4))
    with pytest.raises(FreeDirectionError, match=r"along \(-?1, "):
        _ = result.compliance
    with pytest.raises(RigidDirectionError):
        _ = result.stiffness


def test_idle_freedoms_do_no_harm(rigid_tree: Callable[..., Robot]) -> None:
    """A ring that spins on the arm without a spring, and a rod between two ball joints that spins about itself."""
    rod = pin.JointModelSpherical()
    entries = [
        ("arm", "universe", IDENTITY, pin.JointModelRZ()),
        ("tool", "arm", at(1.0, 0.0, 0.0), None),
        ("ring", "arm", at(0.5, 0.0, 0.0), pin.JointModelRX()),
        ("ball", "universe", at(1.0, -0.4, 0.0), rod),
        ("rod_tip", "ball", at(0.0, 0.4, 0.0), None),
    ]
    tree = rigid_tree(
        entries,
        closures=[LoopClosure("rod_tip", "tool", "3d")],
        actuated_joints=["ring_joint"],
        tool_frame="tool",
    )
    driven = Robot(tree.model, tree.closures, actuated_joints=["arm_joint"], tool_frame="tool")
    springs: list[Spring] = [AxialSpring("rod", "rod_tip", (0, 1, 0), 2e6)]
    springs.append(JointSpring("arm", "arm_joint", 1e6, "N m/rad"))
    model = ElasticModel(driven, springs)
    q = pin.neutral(tree.model)
    result = cartesian_compliance(model, q)
    assert result.motions.unstrained.shape[1] == 2
    assert result.free_directions.shape == (6, 0)
    # tool at radius 1 with the rod along its path: k = 1e6 / 1^2 + 2e6
    assert result.compliance[1, 1] == pytest.approx(1.0 / 3e6, rel=1e-12)
    np.testing.assert_allclose(compliance(model, [q])[0], result.compliance, atol=1e-20)


def test_redundant_constraints_do_no_harm(rigid_tree: Callable[..., Robot]) -> None:
    """A four-bar with a weld at its closure: three of six equations follow from the planar three."""
    crank, coupler, rocker = (
        ("crank", "universe", IDENTITY, pin.JointModelRZ()),
        ("coupler", "crank", at(0.3, 0.0, 0.0), pin.JointModelRZ()),
        ("rocker", "universe", at(0.5, 0.0, 0.0), pin.JointModelRZ()),
    )
    coupler_tip = ("coupler_tip", "coupler", at(0.6, 0.0, 0.0), None)
    hinge = ("rocker_tip", "rocker", at(0.4, 0.0, 0.0), pin.JointModelRZ())
    ball = ("rocker_tip", "rocker", at(0.4, 0.0, 0.0), None)
    trees = {
        kind: rigid_tree(
            [crank, coupler, rocker, coupler_tip, tip],
            closures=[LoopClosure("coupler_tip", "rocker_tip", kind)],
            actuated_joints=["crank_joint"],
            tool_frame="coupler",
        )
        for kind, tip in (("3d", ball), ("6d", hinge))
    }
    results = {}
    for kind, tree in trees.items():
        model = ElasticModel(tree, [JointSpring("motor", "crank_joint", 70.0, "N m/rad")])
        where = tree.assemble(np.full(tree.model.nq, 0.8), joints={"crank_joint": 1.0})
        results[kind] = cartesian_compliance(model, where)
        np.testing.assert_allclose(compliance(model, [where.q])[0], results[kind].compliance, atol=1e-16)
    assert results["3d"].motions.redundant_constraints == 1
    assert results["6d"].motions.redundant_constraints == 3
    np.testing.assert_allclose(results["6d"].compliance, results["3d"].compliance, atol=1e-14)


def test_a_parallel_singularity_frees_the_tool(rigid_tree: Callable[..., Robot]) -> None:
    """A five-bar with collinear distal links: the tool moves across them with both motors at rest."""
    entries = [("x", "universe", IDENTITY, pin.JointModelPX()), ("tool", "x", IDENTITY, pin.JointModelPY())]
    for side, start in (("left", -0.6), ("right", 0.6)):
        entries.append((side, "universe", at(start, 0.0, 0.0), pin.JointModelRZ()))
        entries.append((f"{side}_elbow", side, at(0.0, 0.5, 0.0), pin.JointModelRZ()))
        entries.append((f"{side}_tip", f"{side}_elbow", at(-np.sign(start) * 0.6, 0.0, 0.0), None))
    tree = rigid_tree(
        entries,
        closures=[LoopClosure(f"{side}_tip", "tool", "3d") for side in ("left", "right")],
        actuated_joints=["left_joint", "right_joint"],
        tool_frame="tool",
    )
    springs = [JointSpring(side, f"{side}_joint", 1e3, "N m/rad") for side in ("left", "right")]
    model = ElasticModel(tree, springs)
    in_line = np.array([0.0, 0.5, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(FreeDirectionError, match=r"translation along \(-?0, -?1, -?0\)"):
        _ = cartesian_compliance(model, in_line).compliance
    guess = np.array([0.0, 0.7, -0.2, 0.5, 0.2, -0.5])
    bent = tree.assemble(guess, joints={"left_joint": -0.2, "right_joint": 0.2})
    compliance = cartesian_compliance(model, bent).compliance
    assert compliance[1, 1] > 0.0


# --- frames


def test_stiffness_at_another_frame_of_the_platform(
    elastic: ElasticModel, tripod_positions: Callable[..., np.ndarray]
) -> None:
    (q,) = tripod_positions(POSE[None])
    where = elastic.rigid.configuration(q)
    tool, joint = cartesian_compliance(elastic, q), cartesian_compliance(elastic, q, frame="E1")
    origin, target = (where.frame_placement(name).translation for name in ("O_e", "E1"))
    transform = pin.SE3(np.eye(3), origin - target).action
    assert_same(transform @ tool.compliance @ transform.T, joint.compliance, 1e-12)
    assert_same(transform.T @ joint.stiffness @ transform, tool.stiffness, 1e-10)


def test_a_frame_that_is_not_there(elastic: ElasticModel) -> None:
    with pytest.raises(FrameNotFoundError, match="nowhere"):
        cartesian_compliance(elastic, elastic.rigid.home, frame="nowhere")
    with pytest.raises(FrameNotFoundError, match="nowhere"):
        compliance(elastic, [elastic.rigid.home.q], frame="nowhere")


# --- spring forces


def test_spring_forces_balance_the_wrench(elastic: ElasticModel, tripod_positions: Callable[..., np.ndarray]) -> None:
    """Virtual work: on every motion that keeps the loops closed the springs' forces do the work of the wrench."""
    (q,) = tripod_positions(POSE[None])
    result = cartesian_compliance(elastic, q)
    motions = result.motions.kinematic
    wrench = np.array([100.0, -50.0, 300.0, 5.0, -8.0, 3.0])
    work_outside = (result.configuration.tool_jacobian @ motions).T @ wrench
    work_inside = motions[elastic.spring_indices].T @ (result.spring_forces @ wrench)
    np.testing.assert_allclose(work_inside, work_outside, rtol=1e-9, atol=1e-9 * np.abs(work_outside).max())
    np.testing.assert_allclose(result.contributions.sum(axis=0), result.compliance, rtol=1e-9, atol=1e-22)
    for name, forces, part in zip(
        result.spring_coordinates[:1], result.spring_forces[:1], result.contributions, strict=False
    ):
        assert name == "slider1_joint"
        np.testing.assert_allclose(part, np.outer(forces, forces) / 9.5950e7, rtol=1e-12)


# --- many poses


@pytest.mark.parametrize("robot", ["pm3dof", "hexapod", "three_rps"])
def test_many_poses_are_the_single_pose(robot: str) -> None:
    model = ElasticModel.load(robot)
    home = model.rigid.home.q
    generator = np.random.default_rng(10)
    positions = [home]
    while len(positions) < 20:
        guess = pin.integrate(model.rigid.model, home, generator.uniform(-0.05, 0.05, model.rigid.model.nv))
        positions.append(model.rigid.assemble(guess).q)
    frame = model.rigid.tool_frame
    for q, matrix in zip(positions, compliance(model, positions, frame=frame), strict=True):
        assert_same(matrix, cartesian_compliance(model, q).compliance, 1e-11)


def test_many_poses_mark_or_raise(elastic: ElasticModel) -> None:
    home = np.array(elastic.rigid.home.q)
    apart, nowhere, below = home.copy(), np.full(12, np.nan), home.copy()
    apart[elastic.rigid.single_joint("slider1_joint").q_index] += 0.01
    for joint in ("passive_slider_joint", "slider1_joint", "slider2_joint", "slider3_joint"):
        below[elastic.rigid.single_joint(joint).q_index] -= 0.2
    positions = np.array([home, apart, nowhere, home, below])
    swept = compliance(elastic, positions, on_failure="nan")
    assert np.isnan(swept).all(axis=(1, 2)).tolist() == [False, True, True, False, True]
    np.testing.assert_array_equal(swept[0], swept[3])
    for bad in (apart, nowhere, below):
        with pytest.raises(InvalidValueError):
            compliance(elastic, [home, bad])
    assert compliance(elastic, np.empty((0, 12))).shape == (0, 6, 6)
    assert_same(compliance(elastic, home), swept[0], 1e-14)
    with pytest.raises(InvalidValueError, match="poses"):
        compliance(elastic, home[:5])


def test_a_passive_leg_that_is_drawn_in(elastic: ElasticModel) -> None:
    """With the platform at the clamp the cantilever has no length: the spring is named."""
    q = np.array(elastic.rigid.home.q)
    for joint in ("slider1_joint", "slider2_joint", "slider3_joint"):
        q[elastic.rigid.single_joint(joint).q_index] = -0.2
    where = elastic.rigid.assemble(q, joints={f"slider{k}_joint": -0.2 for k in (1, 2, 3)})
    with pytest.raises(InvalidValueError, match=r"passive_leg.*positive"):
        cartesian_compliance(elastic, where)


def test_configurations_of_other_mechanisms_are_refused(elastic: ElasticModel) -> None:
    again = cartesian_compliance(elastic, Robot.load("pm3dof").home).compliance
    np.testing.assert_array_equal(again, cartesian_compliance(elastic, elastic.rigid.home).compliance)
    with pytest.raises(InvalidValueError, match="configuration"):
        cartesian_compliance(elastic, Robot.load("hexapod").home)
    with pytest.raises(InvalidValueError, match="closed loops"):
        cartesian_compliance(elastic, np.full(12, 0.05))
    with pytest.raises(InvalidValueError, match="shape"):
        elastic.embed(np.zeros(5))
    with pytest.raises(InvalidValueError, match="shape"):
        elastic.project(np.zeros(5))
