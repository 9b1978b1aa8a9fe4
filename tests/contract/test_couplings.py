"""Couplings as exact constraints: mobility, poses, forces, springs, vibrations and errors, on both engines."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
import pytest

import pm3dof_pin as pm
from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.description.couplings import Coupling
from pm3dof_pin.dynamics.inverse_dynamics import _loop_motion
from pm3dof_pin.errors.error_parameters import GeometricErrors, all_parameters
from pm3dof_pin.exceptions import DescriptionError, InvalidValueError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Array

_STEP = 1e-6
_CRANK, _ROD, _HALF = 0.1, 0.25, 0.15


def _link(model: pin.Model, parent: int, joint: pin.JointModel, x: float, name: str, length: float) -> int:
    index = model.addJoint(parent, joint, pin.SE3(np.eye(3), np.array([x, 0.0, 0.0])), name)
    middle = pin.SE3(np.eye(3), np.array([0.5 * length, 0.0, 0.0]))
    model.appendBodyToJoint(index, pin.Inertia.FromCylinder(1.0, 0.01, length), middle)
    return int(index)


def _frame(model: pin.Model, name: str, joint: int, x: float) -> None:
    model.addFrame(pin.Frame(name, joint, 0, pin.SE3(np.eye(3), np.array([x, 0.0, 0.0])), pin.FrameType.OP_FRAME))


def _five_bar(couplings: Sequence[Coupling], drives: Sequence[str], springs: Sequence[dict[str, object]] = ()) -> Robot:
    """A five-bar in the plane y, z, closed by a hinge, whose cranks are mirrored by a gear."""
    model = pin.Model()
    model.name = "geared_five_bar"
    model.gravity = pin.Motion(np.array([0.0, -9.81, 0.0, 0.0, 0.0, 0.0]))
    for side, x in (("left", -_HALF), ("right", _HALF)):
        crank = _link(model, 0, pin.JointModelRZ(), x, f"{side}_crank", _CRANK)
        rod = _link(model, crank, pin.JointModelRZ(), _CRANK, f"{side}_rod", _ROD)
        _frame(model, f"{side}_tip", rod, _ROD)
    height = np.sqrt(_ROD**2 - _HALF**2)  # cranks upright, rods to a common point
    turn = np.arctan2(height, _HALF)
    model.referenceConfigurations["home"] = np.array([0.5 * np.pi, turn - 0.5 * np.pi, 0.5 * np.pi, 0.5 * np.pi - turn])
    loop = LoopClosure("left_tip", "right_tip", "hinge")
    return Robot(model, [loop], couplings=couplings, actuated_joints=drives, tool_frame="left_tip", springs=springs)


_MIRROR = Coupling("right_crank", ("left_crank",), ((-1.0,),), np.pi)


@pytest.fixture(scope="module")
def geared() -> Robot:
    return _five_bar([_MIRROR], ["left_crank"])


def test_a_gear_takes_one_degree_of_freedom(geared: Robot) -> None:
    assert pm.instantaneous_mobility(_five_bar([], ["left_crank", "right_crank"]).home).count == 2
    assert pm.instantaneous_mobility(geared.home).count == 1


def test_mirrored_cranks_move_the_tip_on_a_line(geared: Robot) -> None:
    """By symmetry the tip stays in the middle, at the height of a slider crank."""
    angles = np.linspace(1.1, 2.0, 50)
    for robot in (geared, geared.with_engine("pinocchio")):
        poses = robot.forward(angles[:, None])
        assert poses.solved.all()
        height = _CRANK * np.sin(angles) + np.sqrt(_ROD**2 - (_HALF - _CRANK * np.cos(angles)) ** 2)
        np.testing.assert_allclose(poses.transforms[:, 0, 3], 0.0, atol=1e-12)
        np.testing.assert_allclose(poses.transforms[:, 1, 3], height, atol=1e-12)


def test_the_drive_holds_both_sides_through_the_gear(geared: Robot) -> None:
    """Without the gear two equal drives hold it; the gear carries the torque of one of them."""
    alone = pm.holding_forces(_five_bar([], ["left_crank", "right_crank"]).home)
    coupled = pm.holding_forces(geared.home)
    left, right = alone.actuator_forces
    assert right == pytest.approx(-left, rel=1e-9)
    assert coupled.actuator_forces[0] == pytest.approx(2.0 * left, rel=1e-9)
    assert coupled.closure_forces[-1] == pytest.approx(right, rel=1e-9)


_SPRINGS = [
    {"name": "drive", "type": "joint", "joint": "left_crank", "stiffness": 2e3, "unit": "N m/rad"},
    {"name": "bearing", "type": "closure", "closure": 0, "matrix": np.diag([3e6, 3e6, 4e6, 2e3, 2e3]).tolist()},
]


def test_stiffness_is_that_of_the_geared_drive() -> None:
    """With a bearing ten thousand times as stiff, the tip's compliance along y is (dy/du)^2 / k."""
    stiff = [*_SPRINGS[:1], _SPRINGS[1] | {"matrix": (1e9 * np.eye(5)).tolist()}]
    robot = _five_bar([_MIRROR], ["left_crank"], stiff)
    height, above = np.sqrt(_ROD**2 - _HALF**2), _HALF
    slope = -_CRANK * above / height  # d/du of the height above, at u = 90 degrees
    compliance = pm.compliance(robot, robot.forward(np.array([[0.5 * np.pi]] * 40)))
    np.testing.assert_allclose(compliance[:, 1, 1], slope**2 / 2e3, rtol=2e-4)


def test_a_geared_drive_swings_with_the_inertia_of_both_sides() -> None:
    robot = _five_bar([_MIRROR], ["left_crank"], _SPRINGS[:1])
    u = 0.5 * np.pi + np.array([[_STEP], [-_STEP]])
    rates = np.subtract(*robot.with_engine("pinocchio").forward(u).q) / (2.0 * _STEP)
    mass = pin.crba(robot.model, robot.model.createData(), np.array(robot.home.q))
    mass = np.triu(mass) + np.triu(mass, 1).T
    expected = np.sqrt(2e3 / (rates @ mass @ rates)) / (2.0 * np.pi)
    np.testing.assert_allclose(pm.natural_modes(pm.ElasticModel(robot), robot.home).frequencies, [expected], rtol=1e-8)


def test_both_engines_agree_on_springs() -> None:
    robot = _five_bar([_MIRROR], ["left_crank"], _SPRINGS)
    angles = np.linspace(1.2, 1.9, 40)[:, None]
    both = [pm.compliance(which, which.forward(angles)) for which in (robot, robot.with_engine("pinocchio"))]
    np.testing.assert_allclose(both[0], both[1], atol=1e-9 * np.abs(both[1]).max())


def test_errors_pass_through_the_gear(geared: Robot) -> None:
    errors = GeometricErrors(geared, all_parameters(geared))
    errors = errors.select([name for name in errors.names if name.endswith((".tx", ".ty", ".rz"))])
    poses = geared.forward(np.linspace(1.2, 1.9, 120)[:, None])
    program, reference = (pm.sensitivities(errors, poses, engine=engine) for engine in ("program", "pinocchio"))
    np.testing.assert_allclose(program.errors, reference.errors, atol=1e-9)
    for k, name in enumerate(errors.names):
        ends = [
            errors.apply({name: step}).with_engine("pinocchio").forward(poses[:1].commands, guess=poses[:1].q)
            for step in (_STEP, -_STEP)
        ]
        rate = (ends[0].transforms[0, :3, 3] - ends[1].transforms[0, :3, 3]) / (2.0 * _STEP)
        np.testing.assert_allclose(rate, reference.errors[0, :3, k], atol=1e-7, err_msg=name)


def _cam(coupling: Coupling, kinds: Sequence[pin.JointModel]) -> Robot:
    model = pin.Model()
    model.name = "cam"
    first = _link(model, 0, kinds[0], 0.0, "input", 0.2)
    second = _link(model, 0, kinds[1], 0.5, "output", 0.2)
    _frame(model, "tip", second, 0.2)
    del first
    return Robot(model, couplings=[coupling], tool_frame="tip")


_POLYNOMIAL = Coupling("output", ("input",), ((0.5, -0.3, 0.2, 0.1),), 0.05)


@pytest.mark.parametrize("engine", ["program", "pinocchio"])
def test_polynomials_are_followed_exactly(engine: str) -> None:
    robot = _cam(_POLYNOMIAL, [pin.JointModelRZ(), pin.JointModelRZ()]).with_engine(engine)  # type: ignore[arg-type]
    assert robot.actuated_joints == ("input",)
    x = np.linspace(-1.0, 1.0, 40)
    expected = np.polyval([0.1, 0.2, -0.3, 0.5, 0.05], x)
    np.testing.assert_allclose(robot.forward(x[:, None]).q[:, 1], expected, atol=1e-13)


def test_rates_and_accelerations_follow_the_polynomial() -> None:
    robot = _cam(_POLYNOMIAL, [pin.JointModelRZ(), pin.JointModelRZ()])
    start = robot.forward([[0.4]])[0].configuration()
    motion = _loop_motion(start, [1.5], [-0.7])
    p = np.polynomial.Polynomial([0.05, 0.5, -0.3, 0.2, 0.1])
    assert motion.velocity[1] == pytest.approx(p.deriv()(0.4) * 1.5, abs=1e-12)
    assert motion.acceleration[1] == pytest.approx(p.deriv(2)(0.4) * 1.5**2 - p.deriv()(0.4) * 0.7, abs=1e-12)


@pytest.mark.parametrize("engine", ["program", "pinocchio"])
def test_gears_of_continuous_joints_turn_on(engine: str) -> None:
    coupling = Coupling("output", ("input",), ((-3.0,),), 0.2)
    joints = [pin.JointModelRUBZ()] * 2
    robot = _cam(coupling, joints).with_engine(engine)  # type: ignore[arg-type]
    x = np.linspace(-3.0, 3.0, 61)
    q = robot.forward(x[:, None]).q
    np.testing.assert_allclose(q[:, 2:], np.stack([np.cos(0.2 - 3.0 * x), np.sin(0.2 - 3.0 * x)], axis=1), atol=1e-12)


def test_racks_couple_slides_with_turns() -> None:
    coupling = Coupling("output", ("input",), ((0.04,),))
    robot = _cam(coupling, [pin.JointModelRZ(), pin.JointModelPX()])
    for which in (robot, robot.with_engine("pinocchio")):
        x = np.linspace(-2.0, 2.0, 40)
        np.testing.assert_allclose(which.forward(x[:, None]).q[:, 1], 0.04 * x, atol=1e-14)
    back = _cam(Coupling("input", ("output",), ((25.0,),)), [pin.JointModelRZ(), pin.JointModelPX()])
    np.testing.assert_allclose(back.forward(np.linspace(-0.1, 0.1, 40)[:, None]).q[:, 0], np.linspace(-2.5, 2.5, 40))


def test_ambiguous_angles_are_refused() -> None:
    joints = [pin.JointModelRUBZ(), pin.JointModelRZ()]
    with pytest.raises(DescriptionError, match=r"coupling of 'output'.*angle of 'input' is ambiguous"):
        _cam(Coupling("output", ("input",), ((0.5,),)), joints)


@pytest.mark.parametrize(
    ("others", "powers", "expected"),
    [
        ((), (), "other joints"),
        (("a",), ((1.0,),), "other joints"),
        (("b",), (), "coefficients for each of b"),
        (("b",), ((1.0, 0.0, 0.0, 0.0, 1.0),), "1 to 4 coefficients"),
    ],
)
def test_what_is_no_coupling_is_refused(
    others: tuple[str, ...], powers: tuple[tuple[float, ...], ...], expected: str
) -> None:
    with pytest.raises(InvalidValueError, match=expected):
        Coupling("a", others, powers)


def test_tendons_couple_several_joints() -> None:
    model = pin.Model()
    for name in ("a", "b", "c"):
        _link(model, 0, pin.JointModelRZ(), 0.0, name, 0.1)
    robot = Robot(model, couplings=[Coupling("c", ("a", "b"), ((2.0,), (-0.5,)), 0.1)])
    q: Array = robot.assemble(joints={"a": 0.3, "b": 0.4}).q
    assert q[2] == pytest.approx(0.1 + 0.6 - 0.2, abs=1e-14)
