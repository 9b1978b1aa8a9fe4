"""The motion that a singularity names where there are idle motions too; and the periods of scaled coordinates."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.kinematics.singularity import singularities
from pm3dof_pin.kinematics.units import coordinate_periods

CRANK, ROD = 0.2, 0.5
LIMIT = '<limit lower="-{0}" upper="{0}" effort="1" velocity="1"/>'
JOINTS = (
    ("crank_joint", "revolute", "ground", "crank", "0 0 0", "0 1 0", 3.0),
    ("rod_joint", "revolute", "crank", "rod", f"{CRANK} 0 0", "0 1 0", 3.0),
    ("slide", "prismatic", "ground", "tool", f"{CRANK + ROD} 0 0", "1 0 0", 1.0),
)
CLOSURES = "closed_loop: [[rod_tip, tool]]\ntype: ['3d']\nname_mot: [crank_joint]\ntool_frame: tool\n"


@pytest.fixture(params=[0, 1, 3])
def slider_crank(request: pytest.FixtureRequest, tmp_path: Path) -> Robot:
    """A slider-crank, stretched at q = 0, whose rod has some sleeves that spin idly about it, and a loose vane."""
    joints = [("a_vane_joint", "revolute", "ground", "a_vane", "0 1 0", "0 0 1", 3.0), *JOINTS]
    for k in range(request.param):
        origin, axis = ("0.1 0 0", "1 0 0") if k else ("0 0 0", "1 0.5 0")
        parent = f"sleeve{k - 1}" if k else "rod"
        joints.append((f"sleeve{k}_joint", "revolute", parent, f"sleeve{k}", origin, axis, 3.0))
    last = joints[-1][3] if request.param else "rod"
    rest = ROD - 0.1 * max(request.param - 1, 0)
    links = ["ground", *(joint[3] for joint in joints), "rod_tip"]
    text = "".join(f'<link name="{link}"/>' for link in links) + "".join(
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin xyz="{origin}"/>'
        f'<axis xyz="{axis}"/>{LIMIT.format(reach)}</joint>'
        for name, kind, parent, child, origin, axis, reach in joints
    )
    text += f'<joint name="tip" type="fixed"><parent link="{last}"/><child link="rod_tip"/>'
    text += f'<origin xyz="{rest} 0 0"/></joint>'
    (tmp_path / "slider_crank.urdf").write_text(f'<robot name="slider_crank">{text}</robot>', encoding="utf-8")
    (tmp_path / "slider_crank.closures.yaml").write_text(CLOSURES, encoding="utf-8")
    return Robot.load(tmp_path / "slider_crank.urdf")


def test_at_a_dead_centre_the_drive_moves_and_the_tool_does_not(slider_crank: Robot) -> None:
    """To first order the rod turns against the crank by (crank + rod) / rod, and without a part that is idle.

    The first sleeve's axis is tilted towards that of the rod's joint: with y its part along it, the sleeve's turn by 1
    is idle if the joint turns by -y.
    """
    (found,) = singularities(slider_crank.configuration(np.zeros(slider_crank.model.nq)))
    assert (found.type, found.motions.shape[1]) == ("serial", 1)
    motion = dict(zip(slider_crank.q_names, found.motions[:, 0], strict=True))
    crank, rod, sleeve, y = motion.pop("crank_joint"), motion.pop("rod_joint"), 0.0, 0.5 / np.sqrt(1.25)
    if "sleeve0_joint" in motion:
        sleeve = motion.pop("sleeve0_joint")
        assert sleeve - y * rod == pytest.approx(0.0, abs=1e-12)
    assert abs(crank) > 0.1
    assert rod + y * sleeve == pytest.approx(-crank * (CRANK + ROD) / ROD)
    np.testing.assert_allclose(list(motion.values()), 0.0, atol=1e-12)
    np.testing.assert_allclose(found.twists, 0.0, atol=1e-12)


@pytest.mark.parametrize("vane", ["a_vane", "z_vane"])
def test_in_a_gimbal_lock_the_outer_drives_turn_against_each_other(tmp_path: Path, vane: str) -> None:
    """Axes z, y, z of a wrist at rest, beside a loose vane, whose joint comes first or last."""
    joints = [("yaw", "base", "0 0 1"), ("pitch", "yaw", "0 1 0"), ("roll", "pitch", "0 0 1"), (vane, "base", "1 0 0")]
    text = "".join(
        f'<link name="{name}"/><joint name="{name}_joint" type="revolute"><parent link="{parent}"/>'
        f'<child link="{name}"/><axis xyz="{axis}"/>{LIMIT.format(3.0)}</joint>'
        for name, parent, axis in joints
    )
    (tmp_path / "wrist.urdf").write_text(f'<robot name="wrist"><link name="base"/>{text}</robot>', encoding="utf-8")
    closures = "closed_loop: []\ntype: []\nname_mot: [yaw_joint, pitch_joint, roll_joint]\ntool_frame: roll\n"
    (tmp_path / "wrist.closures.yaml").write_text(closures, encoding="utf-8")
    wrist = Robot.load(tmp_path / "wrist.urdf")
    (found,) = singularities(wrist.configuration(np.zeros(4)))
    motion = dict(zip(wrist.q_names, found.motions[:, 0], strict=True))
    assert found.type == "serial"
    assert abs(motion["yaw_joint"]) == pytest.approx(np.sqrt(0.5))
    assert motion["roll_joint"] == pytest.approx(-motion["yaw_joint"])
    assert motion[f"{vane}_joint"] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("scale", [1.0, -180.0 / np.pi, 0.01])
def test_the_period_of_a_coordinate_is_that_of_a_turn_on_its_scale(slider_crank: Robot, scale: float) -> None:
    turning = Coordinate("a", "rad", tool="rx", scale=scale)
    sliding = Coordinate("b", "m", joint="slide", scale=scale)
    np.testing.assert_allclose(coordinate_periods(slider_crank, [turning, sliding]), [abs(scale) * 2.0 * np.pi, np.inf])
