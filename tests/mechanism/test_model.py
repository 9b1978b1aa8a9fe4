"""Models made joint by joint, compared with those of Pinocchio's own readers."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.description.readers.urdf import read_urdf
from pm3dof_pin.description.robots import find_robot, robot_names
from pm3dof_pin.description.xml_file import read_xml
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.mechanism.model import build_model

MACHINES = Path(__file__).parents[1] / "machines"

_LINK = """<link name="l{0}"><inertial><origin xyz="0.1 0.2 0.3" rpy="0.3 -0.2 0.5"/><mass value="1.5"/>
<inertia ixx="0.2" iyy="0.3" izz="0.4" ixy="0.01" ixz="-0.02" iyz="0.03"/></inertial></link>"""
_JOINT = """<joint name="j{0}" type="{1}"><parent link="{2}"/><child link="l{0}"/>
<origin xyz="0.1 -0.2 {0}" rpy="0.{0} 0.2 -0.4"/><axis xyz="{3}"/>
<limit lower="-1" upper="{0}.5" effort="3" velocity="4"/><dynamics damping="0.5" friction="0.6"/></joint>"""
_CHAIN = [
    ("revolute", "base", "0 0 1"),
    ("fixed", "l0", "0 0 0"),
    ("continuous", "l1", "0 1 0"),
    ("prismatic", "l2", "0.3 0.4 -1"),
    ("continuous", "l1", "-1 2 3"),
    ("floating", "l4", "1 0 0"),
    ("planar", "l5", "0 0 1"),
    ("revolute", "l3", "-1 0 0"),
    ("fixed", "base", "1 0 0"),
]
EVERY_JOINT = (
    '<robot name="every"><link name="base"/>'
    + "".join(_LINK.format(k) + _JOINT.format(k, *row[:1], *row[1:]) for k, row in enumerate(_CHAIN))
    + "</robot>"
)
_ARRAYS = (
    *("lowerPositionLimit", "upperPositionLimit", "lowerEffortLimit", "upperEffortLimit", "upperVelocityLimit"),
    *("lowerDryFrictionLimit", "upperDryFrictionLimit", "damping", "armature"),
)


def _frames(model: pin.Model) -> list[tuple[Any, ...]]:
    return [(frame.name, frame.type, frame.parentJoint, frame.parentFrame) for frame in model.frames]


def _require_equal(model: pin.Model, reference: pin.Model) -> None:
    assert list(model.names) == list(reference.names)
    assert [joint.shortname() for joint in model.joints] == [joint.shortname() for joint in reference.joints]
    assert _frames(model) == _frames(reference)
    for name in _ARRAYS:
        np.testing.assert_array_equal(getattr(model, name), getattr(reference, name), err_msg=name)
    for one, other in zip(model.jointPlacements, reference.jointPlacements, strict=True):
        np.testing.assert_allclose(one.homogeneous, other.homogeneous, rtol=0.0, atol=1e-15)
    for one, other in zip(model.frames, reference.frames, strict=True):
        np.testing.assert_allclose(one.placement.homogeneous, other.placement.homogeneous, rtol=0.0, atol=1e-15)
    for one, other in zip(model.inertias, reference.inertias, strict=True):
        np.testing.assert_allclose(one.matrix(), other.matrix(), rtol=1e-15, atol=1e-15)


@pytest.mark.parametrize("name", [*robot_names(), *sorted(path.name for path in MACHINES.glob("*.urdf"))])
def test_models_are_those_of_pinocchios_reader(name: str) -> None:
    path = find_robot(MACHINES / name if name.endswith(".urdf") else name).urdf
    reference = pin.buildModelFromUrdf(str(path))
    for transmission in ElementTree.parse(path).getroot().findall("transmission"):  # rotors, which it does not read
        rotor = transmission.find("actuator/{http://drake.mit.edu}rotor_inertia")
        if rotor is not None:
            index = reference.joints[reference.getJointId(transmission.find("joint").get("name"))].idx_v
            ratio = float(transmission.find("actuator/mechanicalReduction").text)
            reference.armature[index] = float(rotor.get("value")) * ratio**2
    _require_equal(build_model(read_urdf(read_xml(path))), reference)


def test_every_joint_type_is_that_of_pinocchios_reader(tmp_path: Path) -> None:
    path = tmp_path / "every.urdf"
    path.write_text(EVERY_JOINT, encoding="utf-8")
    model, reference = build_model(read_urdf(read_xml(path))), pin.buildModelFromXML(EVERY_JOINT)
    _require_equal(model, reference)
    q = pin.randomConfiguration(reference, np.full(reference.nq, -1.0), np.full(reference.nq, 1.0))
    np.testing.assert_allclose(
        pin.crba(model, model.createData(), q), pin.crba(reference, reference.createData(), q), rtol=1e-13, atol=1e-13
    )


def test_an_axis_of_a_revolute_joint_may_not_vanish(tmp_path: Path) -> None:
    path = tmp_path / "every.urdf"
    path.write_text(EVERY_JOINT.replace("0.3 0.4 -1", "0 0 0"), encoding="utf-8")
    with pytest.raises(DescriptionError, match="joint 'j3': axis: expected a direction"):
        read_urdf(read_xml(path))
