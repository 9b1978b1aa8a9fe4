"""The typed description: placements, and the checks of names and tree."""

from __future__ import annotations

import dataclasses
import math
import re

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.description.description import Body, Description, Inertial, Joint, Placement
from pm3dof_pin.description.origin import Origin
from pm3dof_pin.exceptions import DescriptionError


@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.0), (0.3, -1.2, 2.5), (0.1, math.pi / 2.0, 0.0)])
def test_placements_turn_about_fixed_axes(angles: tuple[float, ...]) -> None:
    placement = Placement.from_angles((1.0, 2.0, 3.0), angles)
    np.testing.assert_allclose(placement.rotation, pin.rpy.rpyToMatrix(*angles), atol=1e-15)
    again = Placement.from_angles(placement.position, Placement.from_se3(placement.se3).roll_pitch_yaw)
    np.testing.assert_allclose(again.rotation, placement.rotation, atol=1e-15)
    np.testing.assert_allclose((placement * placement.inverse()).se3.homogeneous, np.eye(4), atol=1e-15)


def test_inertials_are_turned_into_the_axes_of_the_body() -> None:
    inertial = Inertial(
        2.0, Placement.from_angles((0.1, 0.0, 0.0), (0.0, 0.0, math.pi / 2.0)), (1.0, 2.0, 2.5, 0, 0, 0)
    )
    np.testing.assert_allclose(inertial.inertia.inertia, np.diag([2.0, 1.0, 2.5]), atol=1e-15)
    again = Inertial.from_inertia(inertial.inertia)
    np.testing.assert_allclose(again.inertia.matrix(), inertial.inertia.matrix(), atol=1e-15)


def _joint(name: str, parent: str, child: str) -> Joint:
    return Joint(name, "revolute", parent, child, origin=Origin("arm.urdf", 7))


_BODIES = (Body("a"), Body("b"), Body("c"))


@pytest.mark.parametrize(
    ("bodies", "joints", "message"),
    [
        ((), (), "has no bodies"),
        ((*_BODIES, Body("a")), (), "link 'a' is defined twice"),
        (_BODIES, (_joint("j", "a", "b"), _joint("k", "c", "b")), "line 7: link 'b' is the child of two joints"),
        (_BODIES, (_joint("j", "a", "d"),), "line 7: joint 'j': child = expected an existing link, not 'd'"),
        (_BODIES, (_joint("j", "a", "b"),), "has several root links, expected one: a, c"),
        (_BODIES, (_joint("j", "b", "c"), _joint("k", "c", "b")), "link 'b' is its own ancestor"),
    ],
)
def test_what_is_no_tree_is_refused(bodies: tuple[Body, ...], joints: tuple[Joint, ...], message: str) -> None:
    with pytest.raises(DescriptionError) as error:
        Description("arm", bodies, joints, origin=Origin("arm.urdf"))
    words = [part for part in re.split(r" (?:is|=) |: ", message) if part]
    assert all(word in str(error.value) for word in words), str(error.value)


def test_a_description_does_not_change() -> None:
    description = Description("arm", _BODIES[:2], (_joint("j", "a", "b"),))
    with pytest.raises(dataclasses.FrozenInstanceError):
        description.name = "leg"  # type: ignore[misc]
    assert description.root.name == "a"
    assert [body.name for body in description.fixed_to("a")] == ["a"]
