"""Springs made stiffer by their names: all that they consist of gives less by the same factor."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.elastic.tool_deflection import stiffened
from pm3dof_pin.kinematics.robot import Robot

BAR = {"at": "end", "axis": [0, 0, 1], "bending_stiffness": 900.0, "torsional_stiffness": 700.0, "unit": "N m^2"}


@pytest.mark.parametrize(
    "entry",
    [
        {"type": "cantilever", **BAR, "length": 0.05, "axial_stiffness": 6e7, "shear_stiffness": 2e7},
        {"type": "cantilever", **BAR, "length": 0.05, "axial_stiffness": 6e7},  # with the shear of a round bar
        {"type": "cantilever", **BAR, "length": 0.05, "axial_stiffness": 6e7, "shear_stiffness": "rigid"},
        {"type": "axial", "at": "end", "axis": [0, 0, 1], "stiffness": 2e7, "unit": "N/m"},
        {"type": "axial", "at": "end", "axis": [0, 0, 1], "contact": "guide_carriage_20", "preload": 500.0},
        {"type": "beam", "at": "end", "matrix": np.diag([1e7, 2e7, 3e7, 4e4, 5e4, 6e4]).tolist()},
    ],
    ids=["shear", "usual shear", "no shear", "axial", "contact", "beam"],
)
def test_a_stiffer_spring_gives_less_in_proportion(rigid_tree: Callable[..., Robot], entry: dict[str, Any]) -> None:
    """The only spring between base and tool: C of it made f times stiffer is C / f."""
    tree = rigid_tree([("end", "universe", pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.05])), None)], tool_frame="end")
    robot = tree.replace(springs=[{"name": "it", **entry}])
    before, after = (
        cartesian_compliance(ElasticModel(each), []).compliance for each in (robot, stiffened(robot, {"it": 2.5}))
    )
    np.testing.assert_allclose(after, before / 2.5, rtol=1e-12, atol=0.0)
