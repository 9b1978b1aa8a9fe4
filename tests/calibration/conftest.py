"""Mechanisms for the tests of errors and calibration: the tripod, a serial arm, a planar four-bar, the hexapod."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot

FOUR_BAR = """<robot name="four_bar">
<link name="ground"/><link name="crank"/><link name="coupler"/><link name="rocker"/>
<link name="coupler_tip"/><link name="rocker_tip"/><link name="pen"/>
{joints}
</robot>
"""
REVOLUTE = """<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="{x} 0 0" rpy="0 0 {yaw}"/><axis xyz="0 0 1"/><limit lower="-3.2" upper="3.2" effort="1" velocity="1"/>
</joint>"""
FIXED = """<joint name="{child}_fixed" type="fixed"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="{x} {y} 0" rpy="0 0 {yaw}"/></joint>"""
CLOSURES = "closed_loop: [[coupler_tip, rocker_tip]]\ntype: ['3d']\nname_mot: [crank_joint]\ntool_frame: pen\n"


@pytest.fixture(scope="session")
def tripod_errors() -> GeometricErrors:
    return GeometricErrors.load("pm3dof")


@pytest.fixture(scope="session")
def tripod_nominal(tripod_errors: GeometricErrors, reachable_poses: np.ndarray) -> Poses:
    """300 poses within all limits."""
    mechanism = tripod_errors.mechanism
    return mechanism.solve(reachable_poses[:300])


@pytest.fixture(scope="session")
def four_bar(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A parallelogram four-bar with a pen on its coupler; q = 0 is assembled."""
    joints = [
        REVOLUTE.format(name="crank_joint", parent="ground", child="crank", x=0.0, yaw=np.radians(80)),
        REVOLUTE.format(name="coupler_joint", parent="crank", child="coupler", x=0.3, yaw=-np.radians(80)),
        REVOLUTE.format(name="rocker_joint", parent="ground", child="rocker", x=0.6, yaw=np.radians(80)),
        FIXED.format(parent="coupler", child="coupler_tip", x=0.6, y=0.0, yaw=0.0),
        FIXED.format(parent="rocker", child="rocker_tip", x=0.3, y=0.0, yaw=0.0),
        FIXED.format(parent="coupler", child="pen", x=0.25, y=0.1, yaw=0.4),
    ]
    path = tmp_path_factory.mktemp("four_bar") / "four_bar.urdf"
    path.write_text(FOUR_BAR.format(joints="\n".join(joints)))
    path.with_suffix(".closures.yaml").write_text(CLOSURES)
    return path


@pytest.fixture(scope="session")
def serial_arm() -> Robot:
    import example_robot_data

    return Robot(example_robot_data.load("ur5").model, tool_frame="tool0")


@pytest.fixture(scope="session")
def cases(tripod_errors: GeometricErrors, four_bar: Path, serial_arm: Robot) -> dict[str, Poses]:
    """A few nominal poses of every mechanism, by name."""
    rng = np.random.default_rng(1)
    hexapod, bar = Robot.load("hexapod"), Robot.load(four_bar)
    commands = {
        "tripod": (tripod_errors.mechanism, rng.uniform(-0.03, 0.03, (4, 3))),
        "hexapod": (hexapod, hexapod.home.actuated_positions + rng.uniform(-0.003, 0.003, (4, 6))),
        "four_bar": (bar, rng.uniform(-0.4, 0.4, (4, 1))),
        "serial": (serial_arm, rng.uniform(-2.0, 2.0, (4, 6))),
    }
    return {name: mechanism.forward(values) for name, (mechanism, values) in commands.items()}


@pytest.fixture(scope="session", params=["tripod", "hexapod", "four_bar", "serial"])
def case(request: pytest.FixtureRequest, cases: dict[str, Poses]) -> Poses:
    poses: Poses = cases[request.param]
    return poses
