from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.exceptions import DescriptionError, FrameNotFoundError, InvalidValueError, JointNotFoundError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration

Vector = NDArray[np.float64]
STEP = 1e-6


def differences(value: Callable[[Configuration], Vector], configuration: Configuration) -> NDArray[np.float64]:
    """Central differences of a value along every velocity, shape=(len(value), nv)."""
    mechanism, q = configuration.mechanism, configuration.q
    columns = []
    for direction in np.eye(mechanism.model.nv):
        ahead, behind = (
            value(mechanism.configuration(pin.integrate(mechanism.model, q, sign * STEP * direction)))
            for sign in (1.0, -1.0)
        )
        columns.append((ahead - behind) / (2.0 * STEP))
    return np.column_stack(columns)


@pytest.fixture(scope="module")
def zoo() -> Robot:
    """Two branches of many kinds of joints, closed by a point and by a frame, in general position."""
    rng = np.random.default_rng(11)
    pin.seed(11)
    model = pin.Model()
    model.name = "zoo"
    branches = (
        (pin.JointModelFreeFlyer(), pin.JointModelRZ(), pin.JointModelPX(), pin.JointModelRUBX()),
        (
            pin.JointModelSpherical(),
            pin.JointModelPrismaticUnaligned(np.array([0.6, 0.0, 0.8])),
            pin.JointModelPlanar(),
        ),
    )
    for branch, joints in enumerate(branches):
        parent = 0
        for depth, joint in enumerate(joints):
            parent = model.addJoint(parent, joint, pin.SE3.Random(), f"joint{branch}{depth}")
            frame = pin.Frame(f"frame{branch}{depth}", parent, 0, pin.SE3.Random(), pin.FrameType.OP_FRAME)
            model.addFrame(frame)
    model.lowerPositionLimit = rng.uniform(-2.0, -1.0, model.nq)
    model.upperPositionLimit = rng.uniform(1.0, 2.0, model.nq)
    closures = [LoopClosure("frame03", "frame12", "3d"), LoopClosure("frame02", "frame11", "6d")]
    return Robot(model, closures, tool_frame="frame10")


@pytest.fixture(params=range(5))
def anywhere(zoo: Robot, request: pytest.FixtureRequest) -> Configuration:
    """A random configuration of this mechanism, with its loops wide open."""
    rng = np.random.default_rng(request.param)
    neutral = pin.neutral(zoo.model)
    return zoo.configuration(pin.integrate(zoo.model, neutral, rng.uniform(-1.0, 1.0, zoo.model.nv)))


def test_constraint_jacobian_is_the_derivative_of_the_closure_error(anywhere: Configuration) -> None:
    expected = differences(lambda configuration: configuration.closure_error, anywhere)
    assert anywhere.closure_residual > 0.1
    np.testing.assert_allclose(anywhere.constraint_jacobian, expected, atol=1e-8, rtol=0.0)


def test_closure_error_is_frame_b_in_frame_a(anywhere: Configuration) -> None:
    point_a, point_b = anywhere.frame_placement("frame03"), anywhere.frame_placement("frame12")
    frame_a, frame_b = anywhere.frame_placement("frame02"), anywhere.frame_placement("frame11")
    expected = [*point_a.actInv(point_b.translation), *pin.log6(frame_a.actInv(frame_b)).vector]
    np.testing.assert_allclose(anywhere.closure_error, expected, atol=1e-14)
    assert anywhere.closure_residual == np.abs(anywhere.closure_error).max()


@pytest.mark.parametrize("frame", ["frame00", "frame03", "frame11", "universe"])
def test_frame_jacobian_gives_the_frames_twist_in_world_axes(anywhere: Configuration, frame: str) -> None:
    here = anywhere.frame_placement(frame)

    def displacement(configuration: Configuration) -> Vector:
        there = configuration.frame_placement(frame)
        return np.concatenate([there.translation, pin.log3(there.rotation @ here.rotation.T)])

    np.testing.assert_allclose(anywhere.frame_jacobian(frame), differences(displacement, anywhere), atol=1e-8)


def test_the_tool_is_one_of_the_frames(anywhere: Configuration) -> None:
    assert anywhere.tool_placement == anywhere.frame_placement("frame10")
    np.testing.assert_array_equal(anywhere.tool_jacobian, anywhere.frame_jacobian("frame10"))


def test_a_jacobian_of_one_joint_is_a_matrix() -> None:
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "joint")
    model.addFrame(pin.Frame("tip", joint, 0, pin.SE3(np.eye(3), np.array([2.0, 0, 0])), pin.FrameType.OP_FRAME))
    model.addFrame(pin.Frame("peg", 0, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    configuration = Robot(model, [LoopClosure("peg", "tip", "3d")], tool_frame="tip").home
    np.testing.assert_allclose(configuration.tool_jacobian, [[0], [2], [0], [0], [0], [1]], atol=1e-15)
    np.testing.assert_allclose(configuration.constraint_jacobian, [[0], [2], [0]], atol=1e-15)


def test_configurations_do_not_share_what_they_hand_out(zoo: Robot) -> None:
    rng = np.random.default_rng(3)
    neutral = pin.neutral(zoo.model)
    q = [pin.integrate(zoo.model, neutral, rng.uniform(-1.0, 1.0, zoo.model.nv)) for _ in range(20)]
    one_by_one = [Robot(zoo.model, zoo.closures, tool_frame=zoo.tool_frame).configuration(x) for x in q]
    jacobians = [configuration.constraint_jacobian.copy() for configuration in one_by_one]
    together = [zoo.configuration(x) for x in q]
    for configuration, jacobian, alone in zip(together, jacobians, one_by_one, strict=True):
        np.testing.assert_array_equal(configuration.constraint_jacobian, jacobian)
        np.testing.assert_array_equal(configuration.closure_error, alone.closure_error)
        np.testing.assert_array_equal(configuration.tool_jacobian, alone.tool_jacobian)
        assert configuration.tool_placement == alone.tool_placement


def test_threads_do_not_disturb_each_other(zoo: Robot) -> None:
    rng = np.random.default_rng(4)
    neutral = pin.neutral(zoo.model)
    q = [pin.integrate(zoo.model, neutral, rng.uniform(-1.0, 1.0, zoo.model.nv)) for _ in range(500)]
    expected = [zoo.configuration(x).constraint_jacobian for x in q]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda x: zoo.configuration(x).constraint_jacobian, q))
    np.testing.assert_array_equal(found, expected)


def test_everything_is_read_only(anywhere: Configuration) -> None:
    arrays = (
        anywhere.q,
        anywhere.closure_error,
        anywhere.constraint_jacobian,
        anywhere.tool_jacobian,
        anywhere.frame_jacobian("frame00"),
    )
    for array in arrays:
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0
    with pytest.raises(AttributeError):
        anywhere.q = np.zeros(3)  # type: ignore[misc]
    kept = anywhere.tool_placement
    anywhere.tool_placement.translation += 1.0
    assert anywhere.tool_placement == kept


def test_the_callers_array_stays_the_callers(five_bar: Robot) -> None:
    q = np.zeros(five_bar.model.nq)
    configuration = five_bar.configuration(q)
    q[0] = 1.0
    assert configuration.q[0] == 0.0


def test_coordinates_of_named_joints(zoo: Robot, five_bar: Robot, crank_rocker: Robot) -> None:
    names = five_bar.q_names
    configuration = five_bar.configuration(0.1 * np.arange(len(names)))
    assert configuration.joint_position("left_elbow") == 0.1 * names.index("left_elbow")
    expected = [0.1 * names.index("left_joint"), 0.1 * names.index("right_joint")]
    np.testing.assert_array_equal(configuration.commands, expected)
    expected = [0.1 * names.index("x_joint"), 0.1 * names.index("y_joint")]
    np.testing.assert_array_equal(five_bar.at(configuration.q).coordinates, expected)
    turned = crank_rocker.assemble(joints={"crank_joint": 2.5}, guess=[1.0, 0.0, 0.4, 0.8])
    assert turned.joint_position("crank_joint") == pytest.approx(2.5, abs=1e-15)
    with pytest.raises(InvalidValueError, match="single-DoF joint"):
        zoo.home.joint_position("joint00")
    with pytest.raises(JointNotFoundError, match="'knee'"):
        zoo.home.joint_position("knee")


def test_violated_limits_name_joint_value_and_bounds(five_bar: Robot) -> None:
    names = five_bar.q_names
    q = np.zeros(len(names))
    q[names.index("x_joint")], q[names.index("left_elbow")], q[names.index("right_elbow")] = 2.5, -3.3, 3.2 + 1e-12
    violations = {violation.name: violation for violation in five_bar.configuration(q).violated_limits()}
    assert set(violations) == {"x_joint", "left_elbow"}
    slide = violations["x_joint"]
    assert (slide.kind, slide.value, slide.lower, slide.upper) == ("joint", 2.5, -2.0, 2.0)
    assert five_bar.home.violated_limits() == ()


def test_limits_of_a_joint_with_several_coordinates(zoo: Robot) -> None:
    q = np.array(pin.neutral(zoo.model))
    q[1] = zoo.upper_limits[1] + 0.5
    names = [violation.name for violation in zoo.configuration(q).violated_limits()]
    assert names == ["joint00[1]"]


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, 1.5, 3.0])
def test_swing_is_the_angle_between_the_z_axes(angle: float) -> None:
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "hinge")
    model.addFrame(pin.Frame("fixed", 0, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    twisted = pin.SE3(pin.utils.rotate("z", 0.7), np.zeros(3))
    model.addFrame(pin.Frame("moving", joint, 0, twisted, pin.FrameType.OP_FRAME))
    mechanism = Robot(model, [LoopClosure("fixed", "moving", "3d", swing_limit=1.0)])
    configuration = mechanism.configuration([angle])
    assert configuration.swing(0) == pytest.approx(angle, abs=1e-15)
    violations = [violation for violation in configuration.violated_limits() if violation.kind == "swing"]
    if angle > 1.0:
        (violation,) = violations
        assert (violation.name, violation.lower, violation.upper) == ("fixed-moving", 0.0, 1.0)
        assert violation.value == pytest.approx(angle, abs=1e-15)
    else:
        assert violations == []


@pytest.mark.parametrize("q", [np.zeros(5), np.zeros((6, 1)), [0, 0, 0, np.nan, 0, 0], [np.inf, 0, 0, 0, 0, 0], 1.0])
def test_what_is_no_configuration_is_refused(five_bar: Robot, q: object) -> None:
    with pytest.raises(InvalidValueError, match=r"^q "):
        five_bar.configuration(q)


def test_a_pair_that_is_no_angle_is_refused(crank_rocker: Robot) -> None:
    with pytest.raises(InvalidValueError, match="length 1"):
        crank_rocker.configuration([0.5, 0.5, 0.0, 0.0])


def test_unknown_frames_are_named(five_bar: Robot) -> None:
    """Of many frames, those with the most similar names."""
    with pytest.raises(FrameNotFoundError, match=r"'left_tipp'.* it has left_tip, .* and \d+ more"):
        five_bar.home.frame_placement("left_tipp")
    with pytest.raises(FrameNotFoundError, match=r"'left_tipp'.* it has left_tip, .* and \d+ more"):
        five_bar.home.frame_jacobian("left_tipp")


def test_the_tool_must_be_named_where_it_is_needed(five_bar: Robot) -> None:
    toolless = Robot(five_bar.model, five_bar.closures, source="little.yaml").home
    for attribute in ("tool_placement", "tool_jacobian"):
        with pytest.raises(DescriptionError, match=r"little\.yaml: tool_frame"):
            getattr(toolless, attribute)


def test_words_for_many_drives_are_few(tmp_path: Path) -> None:
    """Errors name a pose by its commands: of twelve the first eight, so that the reason is seen."""
    links = "".join(
        f'<body pos="0.1 0 0"><joint name="j{k}" axis="0 1 0"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
        for k in range(12)
    )
    motors = "".join(f'<motor joint="j{k}"/>' for k in range(12))
    path = tmp_path / "arm.xml"
    path.write_text(f"<mujoco><worldbody>{links}{'</body>' * 12}</worldbody><actuator>{motors}</actuator></mujoco>")
    robot = Robot.load(path)
    expected = ", ".join(f"{command.name} = 0 deg" for command in robot.commands[:8])
    assert robot.home.in_words == f"{expected}, ... (4 more)"
    assert "more" not in robot.replace(actuated_joints=("j0", "j1"), commands=()).home.in_words
