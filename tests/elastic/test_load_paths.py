"""Ends of load paths: every direction on every robot, limit points and branches by independent mechanics."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import minimize_scalar, root
from scipy.spatial.transform import Rotation

from pm3dof_pin.elastic.buckling import search_buckling
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.loaded import load_deflection, loaded_equilibrium
from pm3dof_pin.elastic.loads import Loads
from pm3dof_pin.elastic.springs import JointSpring
from pm3dof_pin.exceptions import ConvergenceError, DeflectionRangeError
from pm3dof_pin.kinematics.robot import Robot

MACHINES = Path(__file__).parents[1] / "machines"


@pytest.fixture(scope="module")
def hexapod() -> ElasticModel:
    return ElasticModel.load("hexapod")


def pulled(model: ElasticModel, *force: float) -> Loads:
    return Loads({str(model.rigid.tool_frame): [*force, 0.0, 0.0, 0.0]})


# --- the hexapod, as a platform on six explicit springs


class SixStruts:
    """Forces on the platform of the hexapod, and their derivatives, in plain NumPy."""

    def __init__(self, model: ElasticModel) -> None:
        home = model.rigid.home
        tool = home.tool_placement
        self.origin = np.array(tool.translation)
        self.feet, ends = (
            np.array([home.frame_placement(f"{side}{leg}").translation for leg in range(1, 7)]) for side in "AB"
        )
        self.points = (ends - self.origin) @ tool.rotation
        self.turn = Rotation.from_matrix(np.array(tool.rotation))
        self.rest = np.linalg.norm(ends - self.feet, axis=1)
        self.stiffness = 2.0e7

    def forces(self, pose: np.ndarray) -> np.ndarray:
        """Restoring force and moment of the struts for a displacement and a rotation vector, shape=(6,)."""
        arms = (Rotation.from_rotvec(pose[3:]) * self.turn).apply(self.points)
        legs = self.origin + pose[:3] + arms - self.feet
        lengths = np.linalg.norm(legs, axis=1)
        pulls = (self.stiffness * (lengths - self.rest) / lengths)[:, None] * legs
        return np.concatenate([pulls.sum(axis=0), np.cross(arms, pulls).sum(axis=0)])

    def greatest_load(self, force: np.ndarray, start: np.ndarray, factor: float) -> float:
        """The greatest load along the equilibria at given tilts about y, starting from one."""
        scale = np.array([1e-3, 1e-3, 1e-2, 1e-2, 1e-2, 1e5])
        guess = np.append(np.delete(start, 4), factor) / scale

        def load(tilt: float) -> float:
            def balance(unknowns: np.ndarray) -> np.ndarray:
                pose = np.insert(unknowns[:5] * scale[:5], 4, tilt)
                return np.array((self.forces(pose) - 1e5 * unknowns[5] * force) / 1e5)

            found = root(balance, guess, tol=1e-13)
            assert np.abs(found.fun).max() < 1e-6  # of 1e5 N
            return float(1e5 * found.x[5])

        found = minimize_scalar(lambda tilt: -load(tilt), bounds=(start[4], 3.0 * start[4]), options={"xatol": 1e-9})
        return -float(found.fun)


def test_the_limit_point_of_the_hexapod_is_that_of_six_springs(hexapod: ElasticModel) -> None:
    force = np.array([0.01, 0.0, -1.0, 0.0, 0.0, 0.0])
    loads = pulled(hexapod, *force[:3])
    struts = SixStruts(hexapod)
    (below,) = load_deflection(hexapod, hexapod.rigid.home, loads, [640e3])
    pose = np.array(below.displacement())
    np.testing.assert_allclose(struts.forces(pose), 640e3 * force, atol=1e-3)
    search = search_buckling(hexapod, hexapod.rigid.home, loads)
    assert search.load is not None
    assert search.load.kind == "limit point"
    assert search.load.factor == pytest.approx(struts.greatest_load(force, pose, 640e3), rel=1e-7)
    assert search.load.factor == pytest.approx(656_061.45, abs=0.1)


def test_load_deflection_stops_at_the_limit_point(hexapod: ElasticModel) -> None:
    """The hexapod has an equilibrium at 689 kN, but on the other side."""
    with pytest.raises(ConvergenceError, match=r"beyond a factor of 656061\.4.*limit point"):
        load_deflection(hexapod, hexapod.rigid.home, pulled(hexapod, 0.01, 0.0, -1.0), [689e3])


# --- the tripod


def test_pulling_the_tripod_up_never_buckles_it(elastic: ElasticModel) -> None:
    search = search_buckling(elastic, elastic.rigid.home, pulled(elastic, 0.0, 0.0, 1.0))
    assert search.load is None
    assert 1e5 < search.largest_factor < 1e8


def test_a_leg_does_not_bend_two_radians(elastic: ElasticModel) -> None:
    home, sideways = elastic.rigid.home, pulled(elastic, 1.0, 0.0, 0.0)
    search = search_buckling(elastic, home, sideways)
    assert search.load is None
    assert "'passive_leg' deflects" in search.end
    for factor in (0.9, 0.98):
        (point,) = load_deflection(elastic, home, sideways, [factor * search.largest_factor])
        assert np.abs(point.spring_deflections).max() < 1.0
        assert point.configuration.closure_residual < 1e-11
    with pytest.raises(DeflectionRangeError, match="'passive_leg' deflects"):
        loaded_equilibrium(elastic, home, pulled(elastic, 2.0 * search.largest_factor, 0.0, 0.0))


def test_the_nearly_symmetric_tripod_bends_away_and_stays_stable(
    elastic: ElasticModel, caplog: pytest.LogCaptureFixture
) -> None:
    """Straight down it buckles; a hundredth of sideways load leads past the bifurcation onto the stable branch."""
    home = elastic.rigid.home
    buckling = search_buckling(elastic, home, pulled(elastic, 0.0, 0.0, -1.0)).load
    assert buckling is not None
    assert buckling.kind == "bifurcation"
    assert not caplog.text
    factors = buckling.factor * np.array([0.98, 1.02, 1.1])
    bent = load_deflection(elastic, home, pulled(elastic, 0.01, 0.0, -1.0), factors)
    assert all(point.stable for point in bent)
    assert not caplog.text
    straight = load_deflection(elastic, home, pulled(elastic, 0.0, 0.0, -1.0), factors)
    assert all(point.stable for point in straight)
    assert f"bifurcation at a factor of {buckling.factor:.6g}, branch followed: a stable one" in caplog.text
    below, *beyond = zip(straight, bent, strict=True)
    assert abs(below[0].displacement()[5]) < 1e-9
    for one, other in beyond:  # both turn about z, in either direction
        assert abs(one.displacement()[5]) > 0.02
        assert abs(abs(one.displacement()[5]) - abs(other.displacement()[5])) < 0.1 * abs(one.displacement()[5])


# --- small ones


def test_turns_at_a_continuous_joint_are_counted() -> None:
    """35 N m on 10 N m/rad."""
    springs = [JointSpring("coil", "turn", 10.0, "N m/rad")]
    for joint, rest in ((pin.JointModelRUBZ(), [1.0, 0.0]), (pin.JointModelRZ(), [0.0])):
        model = pin.Model()
        index = model.addJoint(0, joint, pin.SE3.Identity(), "turn")
        model.addFrame(pin.Frame("arm", index, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
        arm = ElasticModel(Robot(model, actuated_joints=["turn"], tool_frame="arm"), springs)
        moment = Loads({"arm": [0.0, 0.0, 0.0, 0.0, 0.0, 35.0]})
        curve = load_deflection(arm, rest, moment, [0.5, 1.0, 4.0, -2.0])
        np.testing.assert_allclose(
            [point.spring_deflections[0] for point in curve], [1.75, 3.5, 14.0, -7.0], rtol=1e-12
        )
        assert loaded_equilibrium(arm, rest, moment).spring_deflections == pytest.approx([3.5], rel=1e-12)


@pytest.mark.parametrize("sideways", [6890.0, 0.0])
def test_beyond_a_limit_point_the_hexapod_jumps_to_a_stable_equilibrium(
    sideways: float, hexapod: ElasticModel, caplog: pytest.LogCaptureFixture
) -> None:
    """Newton's method from rest finds an unstable one there; checked on six explicit springs."""
    force = np.array([sideways, 0.0, -689e3, 0.0, 0.0, 0.0])
    found = loaded_equilibrium(hexapod, hexapod.rigid.home, pulled(hexapod, *force[:3]))
    assert "the mechanism jumps to a stable equilibrium elsewhere" in caplog.text
    struts, pose = SixStruts(hexapod), np.array(found.displacement())
    np.testing.assert_allclose(struts.forces(pose), force, atol=1e-2)
    step = 1e-6
    stiffness = np.column_stack(
        [(struts.forces(pose + d) - struts.forces(pose - d)) / (2.0 * step) for d in step * np.eye(6)]
    )
    # of the second variation of the energy, in rotation vectors of the right size: only the signs count
    assert np.linalg.eigvalsh(0.5 * (stiffness + stiffness.T))[0] > 0.0
    assert found.stable


@pytest.mark.parametrize(
    "name",
    [
        "pm3dof",
        "hexapod",
        "three_rps",
        *(str(MACHINES / name) for name in ("delta", "five_bar", "four_bar", "three_rpr")),
    ],
)
def test_any_direction_gives_a_load_or_says_how_far_it_was_looked(name: str) -> None:
    model = ElasticModel.load(name)
    rng = np.random.default_rng(7)
    for _ in range(1 if "pm3dof" not in name else 2):
        direction = rng.normal(size=3)
        search = search_buckling(model, model.rigid.home, pulled(model, *direction / np.linalg.norm(direction)))
        assert search.largest_factor > 0.0
        assert search.end
        if search.load is not None:
            equilibrium = search.load.equilibrium
            assert abs(equilibrium.least_eigenvalue) < 1e-6
            assert equilibrium.configuration.closure_residual < 1e-11
            assert equilibrium.residual < 1e-6 * search.load.factor
