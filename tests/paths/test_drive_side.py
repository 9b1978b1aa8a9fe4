"""Paths of machines with more drives than degrees of freedom, and their singular poses."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.paths.drive_side import DriveSide
from pm3dof_pin.paths.evaluation import evaluate_path
from pm3dof_pin.paths.tool_path import read_path

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts" / "benchmarks"))
from families import Drawing

ANGLES = np.radians([10.0, 110.0, 200.0, 300.0])
CORNERS = np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])


def four_legs(folder: Path, heads: np.ndarray) -> Robot:
    """A planar platform on four driven legs, from corners 0.4 m from the centre to heads, shape=(4, 2) [m]."""
    drawing, platform = Drawing("four_legs"), "base"
    for name, kind, axis in (("x", "prismatic", 0), ("y", "prismatic", 1), ("turn", "revolute", 2)):
        platform = drawing.joint(platform, name, kind=kind, axis=np.eye(3)[axis])
    drawing.tool = platform
    for k, (foot, head) in enumerate(zip(0.4 * CORNERS, heads, strict=True)):
        way = head - foot
        turn = (0.0, 0.0, math.atan2(way[1], way[0]))
        swing = drawing.joint("base", f"swing{k}", (*foot, 0.0), turn, kind="revolute")
        rod = drawing.joint(swing, f"u{k}", kind="prismatic", axis=(1.0, 0.0, 0.0))
        drawing.close(rod, (float(np.hypot(*way)), 0.0, 0.0), platform, (*head, 0.0))
        drawing.drives.append(f"u{k}_joint")
    path = drawing.write(folder)
    file = path.with_suffix(".closures.yaml")
    units = {"x": "m", "y": "m", "rz": "rad"}
    closures = yaml.safe_load(file.read_text(encoding="utf-8"))
    closures["coordinates"] = [{"name": name, "tool": name, "unit": unit} for name, unit in units.items()]
    file.write_text(yaml.safe_dump(closures), encoding="utf-8")
    return Robot.load(path)


def test_a_path_through_singular_poses_of_redundant_drives(tmp_path: Path) -> None:
    """Between similar quadrilaterals, all legs meet in one point wherever the platform is not turned against them.

    The line of a leg from 0.4 c to 0.1 c + p goes through 4/3 p, whatever the corner c. So four lengths leave the
    platform free to turn where rz = 0, and a path through there is on another side until it comes back.
    """
    robot = four_legs(tmp_path, 0.1 * CORNERS)
    file = tmp_path / "path.csv"
    rows = ["0.01,0.0,-6", "0.01,0.005,7", "0.01,0.005,8", "0.01,0.01,-5"]
    file.write_text("\n".join(["x_m,y_m,rz_deg", *rows]), encoding="utf-8")
    found = evaluate_path(robot, read_path(robot, file))
    turned = found.columns["rz_rad"]
    assert (turned != 0.0).all()
    np.testing.assert_array_equal(found.columns["branch"], turned > 0.0)
    np.testing.assert_array_equal(found.columns["within_limits"], turned < 0.0)
    assert found.summary["first_line_beyond_limits"] == 3
    assert found.summary["points_off_branch"] == int((turned > 0.0).sum())


def test_a_path_of_redundant_drives_without_singular_poses(tmp_path: Path) -> None:
    """The same turn with heads crossed over, so that the legs go round the centre: nothing is singular on it."""
    robot = four_legs(tmp_path, 0.1 * CORNERS[[1, 2, 3, 0]])
    file = tmp_path / "path.csv"
    file.write_text("x_m,y_m,rz_deg\n0.01,0.0,-6\n0.01,0.005,7\n", encoding="utf-8")
    assert not evaluate_path(robot, read_path(robot, file)).columns["branch"].any()


@pytest.mark.parametrize("size", [1, 3, 100])
def test_sides_do_not_depend_on_blocks(size: int) -> None:
    """Rates (1, t; 1, -t; 2, 0) of two coordinates lose rank at t = 0, at which the second column changes its sign."""
    times = np.array([-3.0, -1.0, 0.0, 1e-9, 2.0, np.nan, -1.0, 1.0, -2.0, np.nan, np.nan, 5.0, 4.0])
    rates = np.array([[[1.0, t], [1.0, -t], [2.0, 0.0 * t]] for t in times])
    side = DriveSide()
    found = np.concatenate([side.is_other(rates[k : k + size]) for k in range(0, len(rates), size)])
    # unsolved points, and those next to singular ones, tell nothing, and leave the side as it was
    told = [False, False, False, False, True, False, True, False, True, False, False, True, True]
    np.testing.assert_array_equal(found, told)
