"""The calibrated description of a robot in MJCF: a URDF that moves like the calibrated machine."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pm3dof_pin.calibration.calibrated_urdf import write_calibrated_robot
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.kinematics.robot import Robot

CRANK = """<mujoco model="crank"><worldbody>
<body name="crank"><joint name="motor" axis="0 1 0"/><geom size="0.02" mass="0.1"/>
 <body name="rod" pos="0.1 0 0"><joint name="ball" type="ball"/><geom size="0.02" mass="0.1"/></body></body>
<body name="slider" pos="0.5 0 0"><joint name="slide" type="slide" axis="1 0 0"/><geom size="0.02" mass="0.1"/>
 <site name="tool" pos="0 0 0.1"/></body>
</worldbody><equality><connect body1="rod" body2="slider" anchor="0.4 0 0"/></equality>
<actuator><motor joint="motor"/></actuator>
<keyframe><key name="home" qpos="0.3 0.98 0 0.199 0 0"/></keyframe></mujoco>"""


def test_the_calibrated_description_is_a_urdf_with_the_errors_in_it(tmp_path: Path) -> None:
    path = tmp_path / "crank.xml"
    path.write_text(CRANK)
    errors = GeometricErrors.load(path)
    values = 100.0 * errors.sample(np.random.default_rng(3))
    written = Robot.load(write_calibrated_robot(errors, values, tmp_path / "calibrated"))
    calibrated, nominal = errors.apply(values), Robot.load(path)
    held = {"motor": 0.4}
    tools = [robot.assemble(robot.home, joints=held).tool_placement for robot in (written, calibrated, nominal)]
    np.testing.assert_allclose(tools[0].homogeneous, tools[1].homogeneous, atol=1e-12)
    assert np.abs(tools[0].homogeneous - tools[2].homogeneous).max() > 1e-3
