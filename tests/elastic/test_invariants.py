"""Invariants for any springs: symmetry, definiteness, limits, scaling, monotonicity, change of frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.limits import limit_flags
from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.elastic.springs import AxialSpring, BeamSpring, CantileverSpring, ClosureSpring, JointSpring, Spring
from pm3dof_pin.kinematics.robot import Robot

Positions = Callable[[np.ndarray], np.ndarray]
RigidTree = Callable[..., Robot]

some = settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
stiffness_factors = st.floats(-3.0, 3.0).map(lambda exponent: 10.0**exponent)
tilts = st.floats(-0.6, 0.6)
poses = st.tuples(tilts, tilts, st.floats(0.41, 0.56)).map(np.array)


def scaled(spring: Spring, factor: float) -> Spring:
    """The same spring, this many times as stiff."""
    if isinstance(spring, (JointSpring, AxialSpring)):
        return replace(spring, stiffness=factor * spring.stiffness)
    if isinstance(spring, CantileverSpring):
        bending, torsion = factor * spring.bending_stiffness, factor * spring.torsional_stiffness
        return replace(spring, bending_stiffness=bending, torsional_stiffness=torsion)
    return replace(spring, matrix=factor * spring.matrix)


class Machines:
    """The tripod with its springs times factors, statically determinate, and with bushings and a beam, one more."""

    def __init__(self, mechanism: Robot, springs: tuple[Spring, ...], positions: Positions, tripod: Tripod) -> None:
        self.mechanism, self.positions, self.tripod = mechanism, positions, tripod
        beam = np.diag([3e7, 3e7, 9e7, 5e4, 5e4, 2e4])
        beam[0, 4] = beam[4, 0] = -9e5
        beam[1, 3] = beam[3, 1] = 9e5
        more: list[Spring] = [BeamSpring("arm", "E2", beam), ClosureSpring("bushing", 0, np.diag([4e7, 5e7, 6e7]))]
        guide = JointSpring("guide", "passive_slider_joint", 4e6, "N/m")
        self.springs = (*springs, *more, guide)

    def compliance(self, q: np.ndarray, factors: np.ndarray, frame: str | None = None) -> np.ndarray:
        springs = [scaled(spring, factor) for spring, factor in zip(self.springs, factors, strict=True)]
        return np.array(cartesian_compliance(ElasticModel(self.mechanism, springs), q, frame=frame).compliance)


@pytest.fixture(scope="module")
def machines(mechanism: Robot, elastic: ElasticModel, tripod_positions: Positions, tripod: Tripod) -> Machines:
    return Machines(mechanism, elastic.springs, tripod_positions, tripod)


COUNT = 10
factor_lists = st.lists(stiffness_factors, min_size=COUNT, max_size=COUNT).map(np.array)


def units(matrix: np.ndarray) -> np.ndarray:
    return np.sqrt(np.outer(matrix.diagonal(), matrix.diagonal()))


def reachable(machines: Machines, pose: np.ndarray) -> np.ndarray:
    pose = pose if limit_flags(machines.tripod, pose) == 0 else 0.3 * pose + 0.7 * np.array([0.0, 0.0, 0.48])
    return machines.positions(pose[None])[0]


@some
@given(pose=poses, factors=factor_lists)
def test_symmetric_and_positive_definite(machines: Machines, pose: np.ndarray, factors: np.ndarray) -> None:
    springs = [scaled(spring, factor) for spring, factor in zip(machines.springs, factors, strict=True)]
    result = cartesian_compliance(ElasticModel(machines.mechanism, springs), reachable(machines, pose))
    for matrix in (result.compliance, result.stiffness):
        np.testing.assert_array_equal(matrix, matrix.T)
        assert np.linalg.eigvalsh(matrix / units(matrix))[0] > 0.0
    product = result.stiffness @ result.compliance
    scale = np.sqrt(result.compliance.diagonal())
    np.testing.assert_allclose(product * scale[None, :] ** -1 * scale[:, None], np.eye(6), atol=1e-5)
    assert np.abs((result.contributions.sum(axis=0) - result.compliance) / units(result.compliance)).max() < 1e-12
    assert all(np.linalg.eigvalsh(part / units(result.compliance))[0] > -1e-12 for part in result.contributions)


@some
@given(pose=poses, factors=factor_lists, together=stiffness_factors)
def test_all_springs_twice_as_stiff(machines: Machines, pose: np.ndarray, factors: np.ndarray, together: float) -> None:
    q = reachable(machines, pose)
    once, more = machines.compliance(q, factors), machines.compliance(q, together * factors)
    assert np.abs((together * more - once) / units(once)).max() < 1e-10


@some
@given(pose=poses, factors=factor_lists, which=st.integers(0, COUNT - 1), stiffer=st.floats(1.0, 100.0))
def test_a_stiffer_spring_never_softens_any_direction(
    machines: Machines, pose: np.ndarray, factors: np.ndarray, which: int, stiffer: float
) -> None:
    q = reachable(machines, pose)
    before = machines.compliance(q, factors)
    changed = factors.copy()
    changed[which] *= stiffer
    gain = (before - machines.compliance(q, changed)) / units(before)
    assert np.linalg.eigvalsh(gain)[0] > -1e-11


@some
@given(pose=poses, factors=factor_lists, which=st.integers(0, COUNT - 1))
def test_contributions_are_the_derivatives(
    machines: Machines, pose: np.ndarray, factors: np.ndarray, which: int
) -> None:
    """dC / d(ln k) = -C_j, by differences, in a statically indeterminate machine too."""
    q = reachable(machines, pose)
    springs = [scaled(spring, factor) for spring, factor in zip(machines.springs, factors, strict=True)]
    part = cartesian_compliance(ElasticModel(machines.mechanism, springs), q).contributions[which]
    step = 1e-3
    compliances = []
    for k in (-2, -1, 1, 2):
        changed = factors.copy()
        changed[which] *= np.exp(k * step)
        compliances.append(machines.compliance(q, changed))
    far, near = compliances[3] - compliances[0], compliances[2] - compliances[1]
    slope = (8.0 * near - far) / (12.0 * step)
    assert np.abs((slope + part) / units(compliances[1])).max() < 1e-8


@pytest.mark.parametrize("which", range(COUNT))
def test_a_spring_to_infinity_is_as_good_as_none(machines: Machines, which: int) -> None:
    """1e9 times as stiff, or as stiff as may be: a rigid body there, an actuator locked or a passive joint held."""
    q = machines.positions(np.array([[0.2, -0.1, 0.5]]))[0]
    factors = np.ones(COUNT)
    once = machines.compliance(q, factors)
    factors[which] = min(1e9, 9e17 / getattr(machines.springs[which], "stiffness", 1.0))
    limit = machines.compliance(q, factors)
    without = [spring for k, spring in enumerate(machines.springs) if k != which]
    tree = machines.mechanism
    if machines.springs[which].name == "guide":
        actuated = (*tree.actuated_joints, "passive_slider_joint")
        tree = Robot(tree.model, tree.closures, actuated_joints=actuated, tool_frame=tree.tool_frame)
    rigid = np.array(cartesian_compliance(ElasticModel(tree, without), q).compliance)
    assert np.abs((limit - rigid) / units(once)).max() < 1e-7


def test_a_spring_to_zero_is_a_passive_joint(machines: Machines) -> None:
    q = machines.positions(np.array([[0.2, -0.1, 0.5]]))[0]
    factors = np.ones(COUNT)
    factors[-1] = 1e-9
    without = cartesian_compliance(ElasticModel(machines.mechanism, machines.springs[:-1]), q).compliance
    assert np.abs((machines.compliance(q, factors) - without) / units(np.array(without))).max() < 1e-8


def test_an_actuator_without_stiffness_frees_the_tool_in_the_limit(elastic: ElasticModel) -> None:
    """One actuator 1e-6 times as stiff: the platform is 1e6 times as compliant where that actuator holds it."""
    springs = list(elastic.springs)
    home = elastic.rigid.home
    stiff = cartesian_compliance(elastic, home)
    which = elastic.spring_names.index("actuator1")
    springs[which] = scaled(springs[which], 1e-6)
    soft = cartesian_compliance(ElasticModel(elastic.rigid, springs), home)
    added = soft.compliance - stiff.compliance
    expected = (1e6 - 1.0) * stiff.contributions[which]
    assert np.abs((added - expected) / units(soft.compliance)).max() < 1e-9


@pytest.mark.parametrize("ratio", [1e-12, 1e-6, 1.0, 1e6, 1e12, 1e14])
def test_springs_in_series_and_side_by_side(rigid_tree: RigidTree, ratio: float) -> None:
    """Two springs in series, and one at each of two joints of a loop, however different they are."""
    soft, stiff = 3e3, 3e3 * ratio
    one = pin.SE3.Identity()
    tree = rigid_tree([("tip", "universe", one, None)], tool_frame="tip")
    series = [AxialSpring("a", "tip", (1, 0, 0), soft), AxialSpring("b", "tip", (1, 0, 0), stiff)]
    result = cartesian_compliance(ElasticModel(tree, series), [])
    assert result.compliance[0, 0] == pytest.approx(1.0 / soft + 1.0 / stiff, rel=1e-13)

    loop = rigid_tree(
        [
            ("left", "universe", one, pin.JointModelPX()),
            ("right", "universe", one, pin.JointModelPX()),
        ],
        closures=[LoopClosure("left", "right", "6d")],
        actuated_joints=["left_joint", "right_joint"],
        tool_frame="left",
    )
    springs = [JointSpring("left", "left_joint", soft, "N/m"), JointSpring("right", "right_joint", stiff, "N/m")]
    together = cartesian_compliance(ElasticModel(loop, springs), [0.0, 0.0])
    assert together.compliance[0, 0] == pytest.approx(1.0 / (soft + stiff), rel=1e-12)
    assert together.motions.redundant_constraints == 5
    share = together.contributions[:, 0, 0] / together.compliance[0, 0]
    np.testing.assert_allclose(share, np.array([soft, stiff]) / (soft + stiff), rtol=1e-9, atol=1e-15)


@some
@given(pose=poses, factors=factor_lists)
def test_frames_of_one_body_agree(machines: Machines, pose: np.ndarray, factors: np.ndarray) -> None:
    q = reachable(machines, pose)
    where = machines.mechanism.configuration(q)
    origin, target = (where.frame_placement(name).translation for name in ("O_e", "E1"))
    transform = pin.SE3(np.eye(3), origin - target).action
    moved = transform @ machines.compliance(q, factors) @ transform.T
    there = machines.compliance(q, factors, frame="E1")
    assert np.abs((moved - there) / units(there)).max() < 1e-9


def test_a_third_of_a_turn_of_the_machine_turns_its_stiffness(elastic: ElasticModel) -> None:
    """The legs stand 120 degrees apart: at a level platform C is the same when they change places."""
    compliance = cartesian_compliance(elastic, elastic.rigid.home).compliance
    turn = np.kron(np.eye(2), Rotation.from_euler("z", 120, degrees=True).as_matrix())
    turned = turn @ compliance @ turn.T
    assert np.abs((turned - compliance) / units(compliance)).max() < 1e-6
