"""The gain of a position loop on an elastic machine: one mode's closed form, simulation in time, drives of a robot."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from scipy.linalg import expm

import pm3dof_pin as pm
from pm3dof_pin.dynamics import receptance
from pm3dof_pin.dynamics.damping import Damping
from pm3dof_pin.dynamics.receptance import VibratingSystem, vibrating_system
from pm3dof_pin.dynamics.servo_loop import servo_limit, servo_limits
from pm3dof_pin.elastic.springs import JointSpring
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.robot import Robot

MASSES, STIFFNESS, DAMPERS = (12.0, 5.0), (4e7, 9e6), (300.0, 90.0)


def _carts(count: int) -> VibratingSystem:
    """A slide on its drive's spring, and a second one on a spring on it; viscous dampers beside the springs."""
    model = pin.Model()
    model.name = "carts"
    names, parent = ["first", "second"][:count], 0
    for name, mass in zip(names, MASSES, strict=False):
        parent = model.addJoint(parent, pin.JointModelPX(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(parent, pin.Inertia(mass, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", parent, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    robot = Robot(model, [], actuated_joints=names, tool_frame="tip")
    numbers = zip(names, STIFFNESS, DAMPERS, strict=False)
    springs = [JointSpring(f"k_{n}", n, k, "N/m", loss_factor=0.0, damping=c) for n, k, c in numbers]
    return vibrating_system(pm.ElasticModel(robot, springs), np.zeros(count), damping=Damping())


def _grows(gain: float) -> bool:
    """Integrate both carts with the loop's state exactly in time, m the motor's side: m' = K_v (command - x1)."""
    (m1, m2), (k1, k2), (c1, c2) = MASSES, STIFFNESS, DAMPERS
    # the damper is beside the spring to the motor's side, which stands still to it; states x1, x2 absolute, v1, v2, m
    system = np.array(
        [
            [0, 0, 1, 0, 0],
            [0, 0, 0, 1, 0],
            [-(k1 + k2) / m1, k2 / m1, -(c1 + c2) / m1, c2 / m1, k1 / m1],
            [k2 / m2, -k2 / m2, c2 / m2, -c2 / m2, 0],
            [-gain, 0, 0, 0, 0],
        ]
    )
    start = np.array([0.0, 0.0, 0.0, 0.0, 1e-3])
    early, late = (np.abs(expm(system * time) @ start).max() for time in (1.0, 3.0))
    return bool(late > early)


def test_one_mode() -> None:
    """K_v = 2 zeta omega_n = c / m."""
    limit = servo_limit(_carts(1), "first")
    assert limit.critical_gain == pytest.approx(DAMPERS[0] / MASSES[0], rel=1e-6)
    assert limit.critical_frequency == pytest.approx(np.sqrt(STIFFNESS[0] / MASSES[0]) / (2.0 * np.pi), rel=1e-6)
    assert limit.bandwidth == pytest.approx(limit.critical_gain / (4.0 * np.pi))


def test_two_modes_in_time() -> None:
    limit = servo_limit(_carts(2), "first")
    assert not _grows(0.97 * limit.critical_gain)
    assert _grows(1.03 * limit.critical_gain)


def test_dynamic_stiffness_is_solved_once_for_all_drives(monkeypatch: pytest.MonkeyPatch) -> None:
    model = pm.ElasticModel.load("hexapod")
    system, drives = vibrating_system(model, model.rigid.home), list(model.rigid.actuated_joints)
    own = [servo_limit(system, drive) for drive in drives]
    solved, solve = [], np.linalg.solve
    monkeypatch.setattr(np.linalg, "solve", lambda a, b: solved.append(len(a)) or solve(a, b))
    monkeypatch.setattr(receptance, "_AT_ONCE", 1000)
    found = servo_limits(system, drives)
    assert sum(solved) == len(system.frequencies_around_modes())
    assert max(solved) <= 1 + 1000 // system.structural.size
    for limit, alone in zip(found, own, strict=True):
        assert limit.drive == alone.drive
        assert limit.critical_gain == pytest.approx(alone.critical_gain, rel=1e-12)
        assert limit.critical_frequency == pytest.approx(alone.critical_frequency, rel=1e-12)


def test_drives_of_robots() -> None:
    """Damping makes room for gain, in proportion while it is small; a drive without a spring is refused."""
    model = pm.ElasticModel.load("pm3dof")
    limits = [
        servo_limit(vibrating_system(model, model.rigid.home, damping=Damping(loss_factor=eta)), "slider1_joint")
        for eta in (0.01, 0.02)
    ]
    assert limits[1].critical_gain / limits[0].critical_gain == pytest.approx(2.0, rel=0.05)
    with pytest.raises(InvalidValueError, match="slider1_joint"):
        servo_limit(vibrating_system(model, model.rigid.home), "platform_x_joint")
