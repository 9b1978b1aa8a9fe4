"""Loaded equilibria and tangent stiffness: finite differences, minimised potentials, pendulums, trusses, columns."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import least_squares, minimize
from scipy.spatial.transform import Rotation

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.elastic.buckling import search_buckling
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.load_path import LoadPath
from pm3dof_pin.elastic.loaded import load_deflection, loaded_equilibrium
from pm3dof_pin.elastic.loads import Loads
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.elastic.springs import AxialSpring, BeamSpring, CantileverSpring, JointSpring
from pm3dof_pin.exceptions import (
    ConvergenceError,
    DescriptionError,
    FrameNotFoundError,
    FreeDirectionError,
    InvalidValueError,
    RigidDirectionError,
)
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration

RigidTree = Callable[..., Robot]
Positions = Callable[[np.ndarray], np.ndarray]

POSE = np.array([0.25, -0.3, 0.48])
FORCE = np.array([1500.0, -2500.0, -30000.0, 0.0, 0.0, 0.0])
IDENTITY = pin.SE3.Identity()


def at(*position: float) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array(position, dtype=float))


def twist_between(before: Configuration, after: Configuration) -> np.ndarray:
    a, b = before.tool_placement, after.tool_placement
    return np.concatenate([b.translation - a.translation, pin.log3(b.rotation @ a.rotation.T)])


def differences(model: ElasticModel, q: np.ndarray, loads: Loads, steps: np.ndarray) -> np.ndarray:
    """Compliance at the tool by central differences of equilibria in each load, at two step sizes."""
    wrench = np.asarray(loads.wrenches.get("O_e", np.zeros(6)), dtype=float)
    start = loaded_equilibrium(model, q, loads).configuration

    def moved(change: np.ndarray) -> np.ndarray:
        changed = Loads({**loads.wrenches, "O_e": wrench + change}, loads.payloads, loads.own_weight)
        return twist_between(start, loaded_equilibrium(model, q, changed, guess=start).configuration)

    columns = []
    for step, axis in zip(steps, np.eye(6), strict=True):
        near, far = ((moved(h * axis) - moved(-h * axis)) / (2.0 * h) for h in (step, 2.0 * step))
        columns.append((4.0 * near - far) / 3.0)
    return np.stack(columns, axis=1)


def relative(matrix: np.ndarray, expected: np.ndarray) -> float:
    scale = np.sqrt(expected.diagonal())
    return float((np.abs(matrix - expected) / np.outer(scale, scale)).max())


# --- the tripod


@pytest.mark.parametrize(
    "loads",
    [
        Loads({"O_e": FORCE}),
        Loads({"O_e": -0.5 * FORCE, "E2": [0.0, 4000.0, 1000.0, 0.0, 0.0, 0.0]}),
        Loads({"O_e": FORCE + np.array([0, 0, 0, 40.0, -30.0, 60.0]), "link1": [100.0, 0.0, 50.0, 5.0, 0.0, 0.0]}),
        Loads(own_weight=True, payloads={"O_e": 500.0}),
        Loads({"O_e": FORCE}, {"E1": 200.0, "F2": pin.Inertia(50.0, np.array([0.1, 0.0, 0.05]), np.eye(3))}, True),
    ],
    ids=["force", "two forces", "with moments", "weights", "everything"],
)
def test_tangent_compliance_is_the_difference_of_equilibria(
    elastic: ElasticModel, tripod_positions: Positions, loads: Loads
) -> None:
    (q,) = tripod_positions(POSE[None])
    equilibrium = loaded_equilibrium(elastic, q, loads)
    tangent = equilibrium.tangent_compliance()
    steps = np.array([20.0, 20.0, 200.0, 1.0, 1.0, 0.3])
    assert relative(tangent, differences(elastic, q, loads, steps)) < 1e-7
    symmetric = "with moments" if any(np.any(np.asarray(w)[3:]) for w in loads.wrenches.values()) else "yes"
    if symmetric == "yes":
        np.testing.assert_allclose(tangent, tangent.T, atol=1e-12 * np.abs(tangent).max())
    np.testing.assert_allclose(equilibrium.tangent_stiffness() @ tangent, np.eye(6), atol=1e-6)


def test_a_large_load_changes_the_stiffness_much(elastic: ElasticModel, tripod_positions: Positions) -> None:
    """Without the geometric term the tangent would be wrong by more than a tenth here."""
    (q,) = tripod_positions(POSE[None])
    unloaded = cartesian_compliance(elastic, q).compliance
    loaded = loaded_equilibrium(elastic, q, Loads({"O_e": FORCE})).tangent_compliance()
    assert relative(loaded, unloaded) > 0.1


def test_without_loads_it_is_the_unloaded_compliance(elastic: ElasticModel, tripod_positions: Positions) -> None:
    (q,) = tripod_positions(POSE[None])
    equilibrium = loaded_equilibrium(elastic, q, Loads())
    assert relative(equilibrium.tangent_compliance(), cartesian_compliance(elastic, q).compliance) < 1e-12
    assert equilibrium.least_eigenvalue == pytest.approx(1.0, rel=1e-12)
    np.testing.assert_allclose(equilibrium.displacement(), 0.0, atol=1e-14)


def test_displacement_under_a_small_load_is_the_compliance_times_it(
    elastic: ElasticModel, tripod_positions: Positions
) -> None:
    (q,) = tripod_positions(POSE[None])
    wrench = 0.01 * np.array([1.0, -2.0, 30.0, 0.1, 0.05, -0.02])
    expected = cartesian_compliance(elastic, q).compliance @ wrench
    found = loaded_equilibrium(elastic, q, Loads({"O_e": wrench})).displacement()
    np.testing.assert_allclose(found, expected, atol=1e-4 * np.abs(expected).max())


class LoadedTripod:
    """The potential energy of the nonlinear tripod under a dead force at O_e, over the coordinates of its springs.

    Unknown: travels of the sliders, the cantilever's tip (x, y and angles about x, y, z in this order), the angles of
    the platform's universal joint, and its height. The links' elongations follow.
    """

    def __init__(self, tripod: Tripod, pose: np.ndarray, force: np.ndarray) -> None:
        p = tripod.parameters
        self.tripod, self.pose, self.force = tripod, pose, force
        self.joints = np.array(tripod.platform_joints)
        joints = Rotation.from_euler("XYZ", [pose[0], pose[1], 0.0]).apply(self.joints) + np.array([0.0, 0.0, pose[2]])
        across = joints - tripod.base_joints
        along = np.sum(across * tripod.guide_directions, axis=1)
        self.travel = along - np.sqrt(along**2 - np.sum(across**2, axis=1) + p.link_length**2)
        self.scale = np.array([1e-4] * 3 + [1e-4] * 2 + [1e-2] * 3 + [1e-2] * 2 + [1e-4])

    def platform(self, unknowns: np.ndarray) -> tuple[np.ndarray, Rotation]:
        """Return the platform's placements for n sets of unknowns, shape=(n, 11)."""
        x = (self.scale * unknowns).T
        bent = Rotation.from_euler("XYZ", x[5:8].T)
        turned = Rotation.from_euler("XYZ", np.stack([self.pose[0] + x[8], self.pose[1] + x[9], 0.0 * x[9]], axis=-1))
        return np.stack([x[3], x[4], self.pose[2] + x[10]], axis=-1), bent * turned

    def potential(self, unknowns: np.ndarray) -> np.ndarray:
        """Return the energy at n sets of unknowns, shape=(n,)."""
        p, x = self.tripod.parameters, (self.scale * unknowns).T
        position, rotation = self.platform(unknowns)
        sliders = self.tripod.base_joints + (self.travel + x[:3].T)[..., None] * self.tripod.guide_directions
        joints = np.einsum("nij,kj->nki", rotation.as_matrix(), self.joints) + position[:, None]
        stretch = np.linalg.norm(joints - sliders, axis=-1) - p.link_length
        length, ei = position[:, 2] - self.tripod.clamp_height, p.bending_stiffness
        # cubic beam: 12 w^2 - 12 w L slope + 4 L^2 slope^2, over 2 L^3
        bend = sum(
            ei / length**3 * (6.0 * w**2 - 6.0 * w * length * slope + 2.0 * (length * slope) ** 2)
            for w, slope in ((x[3], x[6]), (x[4], -x[5]))
        )
        twist = 0.5 * p.torsional_stiffness / length * x[7] ** 2
        legs = 0.5 * p.actuator_stiffness * (x[:3] ** 2).sum(axis=0) + 0.5 * p.link_stiffness * (stretch**2).sum(axis=1)
        work = (position - np.array([0.0, 0.0, self.pose[2]])) @ self.force
        return np.asarray(legs + bend + twist - work)

    def gradient(self, unknowns: np.ndarray) -> np.ndarray:
        step = 1e-3 * np.eye(11)
        points = unknowns + np.concatenate([step, -step, 2.0 * step, -2.0 * step])
        ahead, behind, far_ahead, far_behind = self.potential(points).reshape(4, 11)
        return np.asarray(8.0 * (ahead - behind) - (far_ahead - far_behind)) / 12e-3

    def displacement(self) -> np.ndarray:
        def energy(unknowns: np.ndarray) -> float:
            return float(self.potential(unknowns[None])[0])

        found = minimize(energy, np.zeros(11), jac=self.gradient, method="BFGS", options={"gtol": 1e-7})
        polished = least_squares(self.gradient, found.x, xtol=1e-15, ftol=1e-15, gtol=1e-15)
        (position,), rotation = self.platform(polished.x[None])
        rest = Rotation.from_euler("XYZ", [self.pose[0], self.pose[1], 0.0])
        return np.concatenate([position - np.array([0.0, 0.0, self.pose[2]]), (rotation * rest.inv()).as_rotvec()[0]])


def test_equilibrium_is_the_minimum_of_the_potential(
    tripod: Tripod, elastic: ElasticModel, tripod_positions: Positions
) -> None:
    """Independent of the package's Jacobians: the explicit potential, minimised by quasi-Newton steps."""
    (q,) = tripod_positions(POSE[None])
    expected = LoadedTripod(tripod, POSE, FORCE[:3]).displacement()
    equilibrium = loaded_equilibrium(elastic, q, Loads({"O_e": FORCE}))
    size = np.abs(expected[:3]).max(), np.abs(expected[3:]).max()
    np.testing.assert_allclose(equilibrium.displacement(), expected, atol=1e-6 * min(size))
    assert equilibrium.stable
    assert equilibrium.residual < 1e-5
    assert equilibrium.configuration.closure_residual < 1e-13


def test_a_stable_equilibrium_is_found_at_204_kilonewtons(tripod: Tripod, elastic: ElasticModel) -> None:
    """Beyond the bifurcation of the straight machine; there is an unstable equilibrium nearby."""
    home = elastic.rigid.home
    force = 204e3 * np.array([0.3, 0.2, -1.0])
    pose = np.array([0.0, 0.0, home.tool_placement.translation[2]])
    equilibrium = loaded_equilibrium(elastic, home, Loads({"O_e": [*force, 0.0, 0.0, 0.0]}))
    assert equilibrium.stable
    expected = LoadedTripod(tripod, pose, force).displacement()
    np.testing.assert_allclose(equilibrium.displacement(), expected, atol=2e-5)


def test_forces_in_the_closures_balance_the_platform(elastic: ElasticModel, tripod_positions: Positions) -> None:
    """Links carry axial forces only, those of their springs."""
    (q,) = tripod_positions(POSE[None])
    equilibrium = loaded_equilibrium(elastic, q, Loads({"O_e": FORCE}))
    where = equilibrium.configuration
    coordinates = list(elastic.spring_coordinates)
    for leg, force in enumerate(equilibrium.closure_forces.reshape(3, 3), start=1):
        stretch = equilibrium.spring_deflections[coordinates.index(f"link{leg}.z")]
        # on E, in the axes of the link's tip, whose z goes from D to E: a stretched link pulls E back
        assert where.mechanism.closures[leg - 1].frame_a == f"link{leg}_tip"
        np.testing.assert_allclose(force, [0.0, 0.0, -1.5177e10 * stretch], atol=1e-6 * 1e4)


# --- closed formulas


def test_a_pendulum_is_held_by_gravity(rigid_tree: RigidTree) -> None:
    """A bob on a massless rod on a passive hinge: sideways stiffness m g / l, and none without its weight."""
    tree = rigid_tree(
        [
            ("trolley", "universe", IDENTITY, pin.JointModelPZ()),
            ("rod", "trolley", IDENTITY, pin.JointModelRY()),
            ("bob", "rod", at(0.0, 0.0, -0.7), None),
        ],
        actuated_joints=["trolley_joint"],
        tool_frame="bob",
    )
    model = ElasticModel(tree, [JointSpring("rope", "trolley_joint", 1e5, "N/m")])
    hanging = loaded_equilibrium(model, [0.0, 0.3], Loads(payloads={"bob": 2.0}))
    np.testing.assert_allclose(hanging.configuration.tool_placement.translation[0], 0.0, atol=1e-12)
    compliance = hanging.tangent_compliance()
    assert compliance[0, 0] == pytest.approx(0.7 / (2.0 * 9.81), rel=1e-12)
    assert compliance[2, 2] == pytest.approx(1e-5, rel=1e-12)
    assert hanging.stable
    with pytest.raises(FreeDirectionError, match="rotation about"):
        loaded_equilibrium(model, [0.0, 0.3], Loads()).tangent_compliance()


def test_a_rigid_direction_under_load_is_named(rigid_tree: RigidTree) -> None:
    tree = rigid_tree([("tip", "universe", IDENTITY, None)], tool_frame="tip")
    model = ElasticModel(tree, [AxialSpring("bar", "tip", (0, 0, 1), 50.0)])
    loaded = loaded_equilibrium(model, [], Loads({"tip": [0, 0, 5.0, 0, 0, 0]}))
    np.testing.assert_allclose(loaded.displacement(), [0, 0, 0.1, 0, 0, 0], atol=1e-14)
    with pytest.raises(RigidDirectionError, match="rigid"):
        loaded.tangent_stiffness()


def truss(rigid_tree: RigidTree, half: float, height: float, stiffness: float) -> ElasticModel:
    """The von Mises truss: two inclined bars with an apex that slides up and down."""
    length, slope = np.hypot(half, height), np.arctan2(height, half)
    tree = rigid_tree(
        [
            ("apex", "universe", at(0.0, 0.0, height), pin.JointModelPZ()),
            (
                "bar",
                "universe",
                pin.SE3(pin.rpy.rpyToMatrix(0.0, -slope, 0.0), np.array([-half, 0.0, 0.0])),
                pin.JointModelRY(),
            ),
            ("end", "bar", at(length, 0.0, 0.0), None),
            ("motor", "universe", IDENTITY, pin.JointModelRZ()),
        ],
        closures=[LoopClosure("end", "apex", "3d")],
        actuated_joints=["motor_joint"],
        tool_frame="apex",
    )
    return ElasticModel(tree, [AxialSpring("bar", "end", (1, 0, 0), stiffness)])


def test_a_shallow_truss_snaps_through_at_its_limit_load(rigid_tree: RigidTree) -> None:
    """P = k (l0 - l) h / l for one of the two bars, with its maximum at l^3 = l0 b^2."""
    half, height, stiffness = 1.0, 0.2, 1e6
    model = truss(rigid_tree, half, height, stiffness)
    rest = np.hypot(half, height)
    length = np.cbrt(rest * half**2)
    limit = stiffness * (rest / length - 1.0) * np.sqrt(length**2 - half**2)
    q = np.zeros(3)
    down = Loads({"apex": [0, 0, -1.0, 0, 0, 0]})
    found = search_buckling(model, q, down).load
    assert found is not None
    assert found.kind == "limit point"
    assert found.factor == pytest.approx(limit, rel=1e-6)
    curve = load_deflection(model, q, down, limit * np.array([0.2, 0.5, 0.9, 0.99]))
    for point in curve:
        h = height + point.displacement()[2]
        force = stiffness * (rest / np.hypot(half, h) - 1.0) * h
        assert force == pytest.approx(point.factor, rel=1e-9)
    with pytest.raises(ConvergenceError, match="turns back"):
        load_deflection(model, q, down, [0.5 * limit, 1.2 * limit])


def test_the_path_goes_through_the_limit_point_and_out_on_the_other_side(rigid_tree: RigidTree) -> None:
    half, height, stiffness = 1.0, 0.2, 1e6
    model = truss(rigid_tree, half, height, stiffness)
    rest = np.hypot(half, height)
    path = LoadPath(model, np.zeros(3), Loads({"apex": [0, 0, -1.0, 0, 0, 0]}), None)
    points = [path.begin(path.unloaded(), 1500.0)]
    for _ in range(60):
        points.append(path.advance(points[-1], 1.0).end)
    heights = np.array([point.state.configuration.tool_placement.translation[2] for point in points])
    factors = np.array([point.factor for point in points])
    np.testing.assert_allclose(factors, stiffness * (rest / np.hypot(half, heights) - 1.0) * heights, atol=1e-4)
    assert (np.diff(heights) < 0.0).all()
    assert heights.min() < -height
    assert factors.max() > 0.0 > factors.min()
    stable = [point.stable for point in points]
    # the tangent stiffness of the bar alone changes sign at l^3 = l0 b^2
    limit = np.sqrt(np.cbrt(rest * half**2) ** 2 - half**2)
    assert stable == [abs(h) > limit for h in heights]


def test_a_double_inverted_pendulum_with_springs_buckles(rigid_tree: RigidTree) -> None:
    """Two rigid links on two torsion springs under a weight: P l / k = (3 - sqrt 5) / 2."""
    entries = [
        ("lower", "universe", IDENTITY, pin.JointModelRY()),
        ("upper", "lower", at(0.0, 0.0, 0.4), pin.JointModelRY()),
        ("top", "upper", at(0.0, 0.0, 0.4), None),
    ]
    tree = rigid_tree(entries, tool_frame="top")
    springs = [JointSpring(name, f"{name}_joint", 50.0, "N m/rad") for name in ("lower", "upper")]
    model = ElasticModel(tree, springs)
    exact = 0.5 * (3.0 - np.sqrt(5.0)) * 50.0 / 0.4
    found = search_buckling(model, [0.0, 0.0], Loads({"top": [0, 0, -1.0, 0, 0, 0]})).load
    assert found is not None
    assert found.kind == "bifurcation"
    assert found.factor == pytest.approx(exact, rel=1e-9)
    assert found.linear_estimate == pytest.approx(exact, rel=1e-12)
    # both links lean to the same side, the upper one by the golden ratio more against the lower one
    assert found.mode[0] / found.mode[1] == pytest.approx(2.0 / (np.sqrt(5.0) - 1.0), rel=1e-4)
    by_payload = search_buckling(model, [0.0, 0.0], Loads(payloads={"top": 1.0})).load
    assert by_payload is not None
    assert by_payload.factor == pytest.approx(exact / 9.81, rel=1e-9)
    half = Loads({"top": [0, 0, -0.5 * exact, 0, 0, 0]})
    with_half = search_buckling(model, [0.0, 0.0], Loads({"top": [0, 0, -1.0, 0, 0, 0]}), permanent=half).load
    assert with_half is not None
    assert with_half.factor == pytest.approx(0.5 * exact, rel=1e-9)


def column(rigid_tree: RigidTree, count: int) -> tuple[ElasticModel, float]:
    length, ei = 2.0 / count, 300.0
    ends = [(f"end{k}", f"end{k - 1}" if k else "universe", at(0.0, 0.0, length), None) for k in range(count)]
    tree = rigid_tree(ends, tool_frame=f"end{count - 1}")
    springs = [CantileverSpring(f"beam{k}", f"end{k}", (0, 0, 1), ei, 1e3, length, 1e7) for k in range(count)]
    return ElasticModel(tree, springs), np.pi**2 * ei / (4.0 * 2.0**2)


def test_a_column_buckles_at_the_load_of_euler(rigid_tree: RigidTree) -> None:
    """A cantilever column divided into beams, each of which shortens as it bends; see also test_flexures."""
    for count in (4, 8):
        model, exact = column(rigid_tree, count)
        found = search_buckling(model, [], Loads({model.rigid.tool_frame: [0, 0, -1.0, 0, 0, 0]})).load
        assert found is not None
        assert found.factor == pytest.approx(exact, rel=1e-4)


def test_a_column_in_tension_gets_stiffer(rigid_tree: RigidTree) -> None:
    model, exact = column(rigid_tree, 4)
    pull = Loads({model.rigid.tool_frame: [0, 0, 1.0, 0, 0, 0]})
    assert search_buckling(model, [], pull, largest_factor=10.0 * exact).load is None
    (stretched,) = load_deflection(model, [], pull, [exact])
    slack = cartesian_compliance(model, []).compliance
    assert stretched.tangent_compliance()[0, 0] < slack[0, 0]


def test_loads_that_only_stiffen_have_no_buckling_load(rigid_tree: RigidTree) -> None:
    tree = rigid_tree(
        [("rod", "universe", IDENTITY, pin.JointModelRY()), ("top", "rod", at(0, 0, 1), None)], tool_frame="top"
    )
    model = ElasticModel(tree, [JointSpring("foot", "rod_joint", 5.0, "N m/rad")])
    assert search_buckling(model, [0.0], Loads({"top": [0, 0, 1.0, 0, 0, 0]})).load is None


def test_large_deflections_of_a_cantilever(rigid_tree: RigidTree) -> None:
    """The elastica under a dead force at its tip, P L^2 / (E I) = 1: 0.30172 L and 0.05643 L (Bisshopp 1945)."""
    results = []
    for count in (8, 16):
        model, _ = column(rigid_tree, count)
        load = 300.0 / 4.0
        (end,) = load_deflection(model, [], Loads({model.rigid.tool_frame: [load, 0, 0, 0, 0, 0]}), [1.0])
        results.append(end.displacement()[[0, 2]] / 2.0)
    extrapolated = (4.0 * results[1] - results[0]) / 3.0
    np.testing.assert_allclose(extrapolated, [0.30172, -0.05643], atol=3e-5)


# --- errors


def test_moments_without_a_potential_have_no_buckling_load(elastic: ElasticModel) -> None:
    home = elastic.rigid.home
    with pytest.raises(InvalidValueError, match="potential"):
        search_buckling(elastic, home, Loads({"O_e": [0, 0, -1e4, 50.0, 30.0, 20.0]}), largest_factor=5.0)


def test_a_mechanism_that_cannot_stand_upright(rigid_tree: RigidTree, caplog: pytest.LogCaptureFixture) -> None:
    tree = rigid_tree(
        [("rod", "universe", IDENTITY, pin.JointModelRY()), ("top", "rod", at(0, 0, 1), None)], tool_frame="top"
    )
    model = ElasticModel(tree, [JointSpring("foot", "rod_joint", 5.0, "N m/rad")])
    heavy = Loads(payloads={"top": 1.0})
    upright = loaded_equilibrium(model, [0.0], heavy, guess=model.configuration([0.0]))
    assert not upright.stable
    # 5 theta = m g l sin theta
    leaning = loaded_equilibrium(model, [0.0], heavy)
    (angle,) = leaning.spring_deflections
    assert 5.0 * angle == pytest.approx(9.81 * np.sin(angle), rel=1e-9)
    assert abs(angle) > 1.0
    assert leaning.stable
    assert "bifurcation at a factor of 0.509684, branch followed: a stable one" in caplog.text  # 5 / 9.81
    # more weight deflects it further, without buckling
    search = search_buckling(model, [0.0], Loads({"top": [0, 0, -1.0, 0, 0, 0]}), permanent=heavy, largest_factor=50.0)
    assert search.load is None
    assert search.largest_factor == 50.0


def test_loads_that_make_no_sense(elastic: ElasticModel) -> None:
    home = elastic.rigid.home
    with pytest.raises(FrameNotFoundError, match="nowhere"):
        loaded_equilibrium(elastic, home, Loads({"nowhere": np.zeros(6)}))
    with pytest.raises(FrameNotFoundError, match="nowhere"):
        loaded_equilibrium(elastic, home, Loads(payloads={"nowhere": 1.0}))
    with pytest.raises(InvalidValueError, match="wrench on O_e"):
        loaded_equilibrium(elastic, home, Loads({"O_e": np.full(6, np.nan)}))
    with pytest.raises(InvalidValueError, match="wrench on O_e"):
        loaded_equilibrium(elastic, home, Loads({"O_e": np.zeros(3)}))
    with pytest.raises(InvalidValueError, match="payload on O_e"):
        loaded_equilibrium(elastic, home, Loads(payloads={"O_e": -1.0}))
    with pytest.raises(InvalidValueError, match="factors"):
        load_deflection(elastic, home, Loads(), [[1.0]])


def test_a_load_that_nothing_bears(rigid_tree: RigidTree) -> None:
    """A passive prismatic joint under a force: it would run away."""
    tree = rigid_tree(
        [("motor", "universe", IDENTITY, pin.JointModelRZ()), ("slide", "motor", IDENTITY, pin.JointModelPX())],
        actuated_joints=["motor_joint"],
        tool_frame="slide",
    )
    model = ElasticModel(tree, [JointSpring("motor", "motor_joint", 10.0, "N m/rad")])
    with pytest.raises(ConvergenceError, match="equilibrium"):
        loaded_equilibrium(model, [0.0, 0.0], Loads({"slide": [1.0, 0, 0, 0, 0, 0]}))


def test_joints_whose_derivatives_are_not_to_be_had(rigid_tree: RigidTree) -> None:
    tree = rigid_tree([("wrist", "universe", IDENTITY, pin.JointModelSphericalZYX())], tool_frame="wrist")
    model = ElasticModel(Robot(tree.model, tool_frame="wrist"), [BeamSpring("post", "wrist_joint", 1e3 * np.eye(6))])
    with pytest.raises(DescriptionError, match="SphericalZYX"):
        loaded_equilibrium(model, np.zeros(3), Loads())
