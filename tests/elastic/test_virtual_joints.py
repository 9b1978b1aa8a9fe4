"""The tree with virtual joints: rigid at zero, and the right bodies move when a spring deflects."""

from __future__ import annotations

import pickle
from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.elastic.batch import compliance
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.springs import AxialSpring, BeamSpring, CantileverSpring, ClosureSpring, JointSpring, Spring
from pm3dof_pin.elastic.virtual_joints import insert_virtual_joints
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.kinematics.robot import Robot

AT = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.2, 0.5), np.array([0.1, -0.2, 0.3]))
SOFT = np.diag([1e3] * 3 + [1e1] * 3)


@pytest.fixture(scope="module", params=["description", "beams everywhere"])
def tripod_model(request: pytest.FixtureRequest, mechanism: Robot) -> ElasticModel:
    if request.param == "description":
        return ElasticModel(mechanism)
    places = ["slider1", "universal2_first_joint", "F3", "link3_tip", "platform", "middle_platform", "O_e", "base"]
    springs: list[Spring] = [BeamSpring(f"beam_{place}", place, SOFT) for place in places]
    springs.append(ClosureSpring("bushing", 1, SOFT[:3, :3]))
    return ElasticModel(mechanism, springs)


def _random(model: ElasticModel, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-0.3, 0.3, model.rigid.model.nq)


def test_all_frames_stand_where_they_did(tripod_model: ElasticModel) -> None:
    q = _random(tripod_model, 1)
    rigid, elastic = tripod_model.rigid.configuration(q), tripod_model.configuration(q)
    for frame in tripod_model.rigid.model.frames:
        before, after = rigid.frame_placement(frame.name), elastic.frame_placement(frame.name)
        np.testing.assert_allclose(after.homogeneous, before.homogeneous, atol=1e-14)
    np.testing.assert_allclose(elastic.closure_error, rigid.closure_error, atol=1e-14)
    np.testing.assert_array_equal(tripod_model.project(elastic.q), q)


def test_masses_stay_where_they_were(tripod_model: ElasticModel) -> None:
    """The mass matrix and the weight on the joints of the rigid tree are those of the tree with virtual joints."""
    q = _random(tripod_model, 2)
    rigid, elastic = tripod_model.rigid.model, tripod_model.mechanism.model
    full = pin.crba(elastic, elastic.createData(), tripod_model.embed(q))
    expected = pin.crba(rigid, rigid.createData(), q)
    names = list(rigid.names)[1:]
    kept = [elastic.joints[elastic.getJointId(name)].idx_v for name in names]
    np.testing.assert_allclose(np.triu(full[np.ix_(kept, kept)]), np.triu(expected), atol=1e-13)
    weights = pin.computeGeneralizedGravity(elastic, elastic.createData(), tripod_model.embed(q))
    np.testing.assert_allclose(weights[kept], pin.computeGeneralizedGravity(rigid, rigid.createData(), q), atol=1e-12)


def test_a_force_on_a_virtual_joint_of_a_loaded_body_is_its_weight(mechanism: Robot) -> None:
    """A spring under the whole platform with its tool carries their weight, one under the tool frame nothing."""
    model = ElasticModel(mechanism, [BeamSpring("under", "platform", SOFT), BeamSpring("tool", "O_e", SOFT)])
    elastic = model.mechanism.model
    weight = pin.computeGeneralizedGravity(elastic, elastic.createData(), model.embed(mechanism.home.q))
    carried = dict(zip(model.spring_coordinates, weight[model.spring_indices], strict=True))
    platform = mechanism.model.inertias[mechanism.model.getJointId("platform_y_joint")].mass
    assert carried["under.z"] == pytest.approx(9.81 * platform, rel=1e-12)
    assert carried["tool.z"] == 0.0


def test_what_belongs_to_the_mechanism_survives(tripod_model: ElasticModel) -> None:
    rigid, elastic = tripod_model.rigid, tripod_model.mechanism
    assert elastic.name == rigid.name
    assert elastic.actuated_joints == rigid.actuated_joints
    assert elastic.motion_coordinates == rigid.motion_coordinates
    assert elastic.tool_frame == rigid.tool_frame
    assert elastic.characteristic_length == rigid.characteristic_length
    assert [closure.swing_limit for closure in elastic.closures] == [closure.swing_limit for closure in rigid.closures]
    assert set(elastic.named_configurations) == set(rigid.named_configurations)
    for name, q in rigid.named_configurations.items():
        np.testing.assert_array_equal(tripod_model.embed(q), elastic.named_configurations[name])
    np.testing.assert_array_equal(tripod_model.project(elastic.lower_limits), rigid.lower_limits)
    np.testing.assert_array_equal(tripod_model.project(elastic.upper_limits), rigid.upper_limits)
    for joint in list(rigid.model.names)[1:]:
        old, new = (model.joints[model.getJointId(joint)] for model in (rigid.model, elastic.model))
        for constant in ("upperEffortLimit", "upperVelocityLimit", "damping", "upperDryFrictionLimit", "armature"):
            assert getattr(elastic.model, constant)[new.idx_v] == getattr(rigid.model, constant)[old.idx_v]
    assert elastic.model.check(elastic.model.createData())


def test_virtual_joints_have_no_limits(elastic: ElasticModel) -> None:
    virtual = np.setdiff1d(np.arange(elastic.mechanism.model.nq), elastic.embed(np.arange(1, 13)).nonzero()[0])
    assert np.isneginf(elastic.mechanism.lower_limits[virtual]).all()
    assert np.isposinf(elastic.mechanism.upper_limits[virtual]).all()


def test_the_rigid_mechanism_is_left_as_it_is(mechanism: Robot) -> None:
    before = mechanism.model.saveToString()
    ElasticModel(mechanism)
    assert mechanism.model.saveToString() == before


@pytest.mark.parametrize("at", ["link2_tip", "universal2_second_joint", "D2"])
def test_what_hangs_on_the_place_moves_along_the_axes_of_the_place(mechanism: Robot, at: str) -> None:
    """All six motions, for a place on a link, a movable joint and a frame followed by a joint."""
    model = ElasticModel(mechanism, [BeamSpring("beam", at, SOFT)])
    q = _random(model, 3)
    moving = {"link2_tip": ["link2_tip"], "universal2_second_joint": ["link2", "F2", "link2_tip"], "D2": ["D2"]}[at]
    still = {
        "link2_tip": ["link2", "F2", "D2"],
        "universal2_second_joint": ["cross2", "D2"],
        "D2": ["link2", "slider2"],
    }
    place = _place(model.rigid, q, at)
    for k, joint in enumerate(model.spring_coordinates):
        elastic_q = model.embed(q)
        elastic_q[model.mechanism.single_joint(joint).q_index] = 0.01
        before, after = model.configuration(q), model.mechanism.configuration(elastic_q)
        shift = 0.01 * np.eye(6)[k]
        motion = place * pin.SE3(pin.exp3(shift[3:]), shift[:3]) * place.inverse()
        for frame in moving:
            expected = motion * before.frame_placement(frame)
            np.testing.assert_allclose(after.frame_placement(frame).homogeneous, expected.homogeneous, atol=1e-14)
        for frame in [*still[at], "E1", "link1_tip", "O_e"]:
            expected = before.frame_placement(frame)
            np.testing.assert_allclose(after.frame_placement(frame).homogeneous, expected.homogeneous, atol=1e-14)


def _place(mechanism: Robot, q: np.ndarray, at: str) -> pin.SE3:
    """The place of the virtual joints: a frame, or the place of a joint on the previous body."""
    model, data = mechanism.model, mechanism.model.createData()
    if not model.existJointName(at):
        return mechanism.configuration(q).frame_placement(at)
    pin.forwardKinematics(model, data, q)
    joint = model.getJointId(at)
    return data.oMi[model.parents[joint]] * model.jointPlacements[joint]


def test_an_axis_is_in_the_axes_of_the_place(mechanism: Robot) -> None:
    axis = np.array([2.0, -1.0, 0.5])
    for direction in (axis, np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0])):
        model = ElasticModel(mechanism, [AxialSpring("link", "link1_tip", tuple(direction), 1.0)])
        q = model.embed(_random(model, 4))
        before = model.mechanism.configuration(q).frame_placement("link1_tip")
        q[model.mechanism.single_joint("link.z").q_index] = 0.01
        after = model.mechanism.configuration(q).frame_placement("link1_tip")
        expected = before.rotation @ direction / np.linalg.norm(direction) * 0.01
        np.testing.assert_allclose(after.translation - before.translation, expected, atol=1e-15)
        np.testing.assert_allclose(after.rotation, before.rotation, atol=1e-15)


def test_freedoms_of_each_type(mechanism: Robot) -> None:
    slender = CantileverSpring("slender", "P", (0, 0, 1), 1.0, 1.0, 1.0)
    long = CantileverSpring("long", "E1", (0, 0, 1), 1.0, 1.0, 1.0, axial_stiffness=1.0)
    springs = [slender, long, AxialSpring("bar", "F1", (0, 0, 1), 1.0), ClosureSpring("ball", 0, np.eye(3))]
    joints = insert_virtual_joints(mechanism, [*springs, JointSpring("motor", "slider1_joint", 1.0, "N/m")]).joints
    motions = {name: [joint.split(".")[1] for joint in chain] for name, chain in joints.items()}
    assert motions == {
        "slender": ["x", "y", "rx", "ry", "rz"],
        "long": ["x", "y", "z", "rx", "ry", "rz"],
        "bar": ["z"],
        "ball": ["x", "y", "z"],
    }


def test_springs_at_one_place_stand_in_series(rigid_tree: Callable[..., Robot]) -> None:
    tree = rigid_tree([("tip", "universe", AT, None)], tool_frame="tip")
    springs = [AxialSpring("first", "tip", (1, 0, 0), 2.0), AxialSpring("second", "tip", (1, 0, 0), 3.0)]
    model = ElasticModel(tree, springs)
    q = np.array([0.1, 0.01])
    moved = model.mechanism.configuration(q).tool_placement.translation - AT.translation
    np.testing.assert_allclose(moved, AT.rotation[:, 0] * 0.11, atol=1e-15)


def test_nested_cuts_of_one_body(rigid_tree: Callable[..., Robot]) -> None:
    """A body with three successive places: a spring at the second moves the third, but not the first."""
    tree = rigid_tree(
        [
            ("arm", "universe", AT, pin.JointModelRZ()),
            ("one", "arm", AT, None),
            ("two", "one", AT, None),
            ("three", "two", AT, None),
            ("hand", "three", AT, pin.JointModelRX()),
            ("other_hand", "one", AT, pin.JointModelRX()),
        ],
        tool_frame="hand",
    )
    model = ElasticModel(tree, [AxialSpring("b", "three", (0, 1, 0), 1.0), AxialSpring("a", "two", (0, 0, 1), 1.0)])
    assert model.mechanism.model.check(model.mechanism.model.createData())
    q = model.embed(np.array([0.3, 0.4, 0.5]))
    rest = model.mechanism.configuration(q)
    for joint, moving in (("a.z", {"two", "three", "hand"}), ("b.z", {"three", "hand"})):
        moved_q = q.copy()
        moved_q[model.mechanism.single_joint(joint).q_index] = 0.01
        moved = model.mechanism.configuration(moved_q)
        for frame in ("arm", "one", "two", "three", "hand", "other_hand"):
            distance = np.linalg.norm(
                (rest.frame_placement(frame).inverse() * moved.frame_placement(frame)).translation
            )
            assert distance == pytest.approx(0.01 if frame in moving else 0.0, abs=1e-15)


def test_a_closure_that_gives_leaves_its_frames_alone(mechanism: Robot) -> None:
    """The new frame is closed with frame b; frame a and its body stay in place when the closure deflects."""
    model = ElasticModel(mechanism, [ClosureSpring("ball", 1, np.eye(3))])
    q = model.embed(mechanism.home.q)
    q[model.mechanism.single_joint("ball.x").q_index] = 0.01
    moved = model.mechanism.configuration(q)
    home = mechanism.home.frame_placement("link2_tip").homogeneous
    np.testing.assert_allclose(moved.frame_placement("link2_tip").homogeneous, home, atol=1e-15)
    np.testing.assert_allclose(moved.closure_error[3:6], [-0.01, 0.0, 0.0], atol=1e-15)
    assert model.mechanism.closures[1].frame_b == mechanism.closures[1].frame_b
    assert model.mechanism.closures[0] == mechanism.closures[0]


def test_joints_with_several_freedoms_and_continuous_ones(rigid_tree: Callable[..., Robot]) -> None:
    tree = rigid_tree(
        [
            ("ball", "universe", AT, pin.JointModelSpherical()),
            ("wheel", "ball", AT, pin.JointModelRUBZ()),
            ("float", "universe", AT, pin.JointModelFreeFlyer()),
            ("tip", "wheel", AT, None),
        ],
        tool_frame="tip",
    )
    model = ElasticModel(tree, [BeamSpring("shaft", "wheel_joint", SOFT), BeamSpring("hull", "float_joint", SOFT)])
    q = pin.randomConfiguration(tree.model, -np.ones(tree.model.nq), np.ones(tree.model.nq))
    for frame in ("ball", "wheel", "float", "tip"):
        np.testing.assert_allclose(
            model.configuration(q).frame_placement(frame).homogeneous,
            tree.configuration(q).frame_placement(frame).homogeneous,
            atol=1e-14,
        )


def test_names_that_are_taken(rigid_tree: Callable[..., Robot]) -> None:
    tree = rigid_tree([("tip", "universe", AT, None), ("a.z", "tip", AT, None)], tool_frame="tip")
    with pytest.raises(DescriptionError, match=r"a\.z"):
        ElasticModel(tree, [AxialSpring("a", "tip", (0, 0, 1), 1.0)])


def test_a_loop_of_two_arms_keeps_its_closures(rigid_tree: Callable[..., Robot]) -> None:
    tree = rigid_tree(
        [
            ("left", "universe", pin.SE3.Identity(), pin.JointModelRZ()),
            ("left_tip", "left", AT, None),
            ("right", "universe", pin.SE3.Identity(), pin.JointModelRZ()),
            ("right_tip", "right", AT, None),
        ],
        closures=[LoopClosure("left_tip", "right_tip", "6d")],
        actuated_joints=["left_joint"],
        tool_frame="left_tip",
    )
    springs: list[Spring] = [ClosureSpring("weld", 0, SOFT), JointSpring("motor", "left_joint", 5.0, "N m/rad")]
    model = ElasticModel(tree, springs)
    assert model.mechanism.closures == (LoopClosure("weld.anchor", "right_tip", "6d"),)
    assert model.configuration([0.2, 0.2]).closure_residual < 1e-15
    assert model.mechanism.model.check(model.mechanism.model.createData())


def test_a_pickled_model_computes_the_same():
    """Also one whose programs are compiled; they are not part of the copy."""
    model = ElasticModel.load("hexapod")
    home = np.array(model.rigid.home.q)
    before = compliance(model, home)
    copy = pickle.loads(pickle.dumps(model))
    assert not copy.programs
    assert np.array_equal(compliance(copy, home), before)
