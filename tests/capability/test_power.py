"""Power is the same at drives and joints, and the example of a published mapping of efforts that made some.

Rates by joints and rates by drives come from two Jacobians that are recorded and solved separately: that torques map by
the transpose of the one and rates by the other is a statement about both. They agree to rounding, of which programs
with pivots chosen at sample poses lose some digits at a few poses.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pm3dof_pin as pm
from pm3dof_pin.capability.transmission import joint_driven, transmission
from pm3dof_pin.kinematics.reachable_poses import reachable_poses

_MACHINES = Path(__file__).parents[1] / "machines"
_POSES = 10_000

_PARALLELOGRAM = """
<mujoco model="arm">
  <!-- One motor on the base turns the upper arm, another the forearm, by a crank and a rod parallel to the arm. -->
  <worldbody>
    <body name="upper_arm">
      <joint name="shoulder" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/>
      <body name="forearm" pos="0.3 0 0">
        <joint name="elbow" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0.2 0 -0.1" size="0.02"/>
        <site name="lever" pos="0 0 0.06"/>
      </body>
    </body>
    <body name="crank">
      <joint name="crank" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.06" size="0.01"/>
      <body name="rod" pos="0 0 0.06">
        <joint name="rod" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.01"/>
        <site name="rod_end" pos="0.3 0 0"/>
      </body>
    </body>
  </worldbody>
  <equality>
    <connect site1="rod_end" site2="lever"/>
  </equality>
  <actuator>
    <motor joint="shoulder"/>
    <motor joint="crank"/>
  </actuator>
</mujoco>
"""


@pytest.mark.parametrize(
    "name",
    ["ankle_rus", "ankle_spu", "hexapod", "linear_delta", "pm3dof", "three_rps", "agile_eye", "delta", "five_bar"],
)
def test_power_is_the_same_on_both_sides(name: str) -> None:
    folder = _MACHINES / name
    robot = pm.load(folder if folder.is_dir() else name)
    generator = np.random.default_rng(7)
    poses = reachable_poses(robot, _POSES, generator)
    drives, joints = robot.actuated_joints, [coordinate.name for coordinate in robot.coordinates]
    G = pm.jacobian(robot, poses, of=drives, by=joints).values
    back = pm.jacobian(robot, poses, of=joints, by=drives).values
    torques, speeds = generator.normal(size=(2, _POSES, len(drives)))
    joint_torques, joint_speeds = np.einsum("nuj,nu->nj", G, torques), np.einsum("nju,nu->nj", back, speeds)
    at_drives, at_joints = (np.einsum("nu,nu->n", *pair) for pair in ((torques, speeds), (joint_torques, joint_speeds)))
    # what rounding of the products is relative to
    scale = np.einsum("nu,nuj,njw,nw->n", *map(np.abs, (torques, G, back, speeds)))
    errors = np.abs(at_drives - at_joints) / scale
    assert np.quantile(errors, 0.99) < 1e-12
    assert errors.max() < 1e-11
    mapped = np.einsum("nu,nuj,nj->n", torques, G, joint_speeds)  # with one Jacobian for both, as users do
    assert (np.abs(mapped - np.einsum("nj,nj->n", joint_torques, joint_speeds)) / scale).max() < 1e-14


def test_a_parallelogram_drives_the_elbow_by_the_difference(tmp_path: Path) -> None:
    """Motors 1 and 2 turn the joints by x1 and x2 - x1, so that the joints have the torques t1 + t2 and t2.

    A transmission of ros2_control had t1 and t2 - t1 (ros-controls/ros2_control, 1746), and power out of nothing: with
    rates 1 and 0 and torques 0 and 1 of the motors, neither of which gives any.
    """
    (tmp_path / "arm.xml").write_text(_PARALLELOGRAM)
    robot = joint_driven(pm.load(tmp_path / "arm.xml"), ["shoulder", "elbow"])
    assert robot.actuated_joints == ("shoulder", "crank")
    values = np.random.default_rng(2).uniform([-0.8, -1.0], [0.8, 1.0], (200, 2))
    at = transmission(robot, robot.solve(values))
    np.testing.assert_allclose(at.jacobian, np.broadcast_to([[1.0, 0.0], [1.0, 1.0]], (200, 2, 2)), atol=1e-12)
    np.testing.assert_allclose(at.poses.commands[:, 1], values.sum(axis=1), atol=1e-12)
    rates, torques = np.array([1.0, 0.0]), np.array([0.0, 1.0])
    back = pm.jacobian(robot, at.poses, of=["shoulder", "elbow"], by=robot.actuated_joints).values
    joint_rates, joint_torques = back @ rates, at.jacobian.swapaxes(-1, -2) @ torques
    np.testing.assert_allclose(joint_rates, np.broadcast_to([1.0, -1.0], (200, 2)), atol=1e-12)
    np.testing.assert_allclose(joint_torques, np.broadcast_to([1.0, 1.0], (200, 2)), atol=1e-12)
    np.testing.assert_allclose(np.einsum("nj,nj->n", joint_rates, joint_torques), 0.0, atol=1e-12)
    published = np.array([torques[0], torques[1] - torques[0]])
    assert published @ joint_rates[0] == pytest.approx(-1.0)
