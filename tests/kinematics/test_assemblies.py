"""Homes found from random starts, where the described one cannot be closed."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pm3dof_pin.exceptions import ConvergenceError
from pm3dof_pin.kinematics import assemblies
from pm3dof_pin.kinematics.assemblies import assembled_homes, closing_trial
from pm3dof_pin.kinematics.assembly import Assembly
from pm3dof_pin.kinematics.robot import Robot

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts" / "benchmarks"))
from families import scissor

_JOINT = (
    '<link name="{1}"/><joint name="{1}_joint" type="continuous"><parent link="{0}"/><child link="{1}"/>'
    '<origin xyz="{2} 0 0"/><axis xyz="0 0 1"/></joint>'
)


def _two_arms(folder: Path, base: float) -> Path:
    """Write two arms of two bars of 1 m each, all along x at zero, that are to meet at their ends."""
    arms = _JOINT.format("base", "a1", 0) + _JOINT.format("a1", "a2", 1)
    arms += _JOINT.format("base", "b1", base) + _JOINT.format("b1", "b2", 1)
    ends = '<predecessor link="a2"><origin xyz="1 0 0"/></predecessor><successor link="b2"><origin xyz="1 0 0"/>'
    loop = f'<loop name="tip" type="revolute">{ends}</successor><axis xyz="0 0 1"/></loop>'
    path = folder / "arms.urdf"
    path.write_text(f'<robot name="arms"><link name="base"/>{arms}{loop}</robot>')
    return path


def test_a_stretched_home_closes_from_random_starts(tmp_path: Path, answer: Callable[..., Any], run: Any) -> None:
    """All bars point along the gap, so that no bar moves its end along it: the zero pose stays open by 0.5 m."""
    path = _two_arms(tmp_path, 0.5)
    robot = Robot.load(path)
    assert robot.home.closure_residual == pytest.approx(0.5)
    trial = closing_trial(robot)
    assert (trial.starts, trial.closed) == (30, 30)
    assert "they close from 30 of 30 random starts" in run("info", str(path)).stdout
    homes = assembled_homes(robot)
    assert all(home.configuration.closure_residual < 1e-9 for home in homes)
    answer("info", str(path), "--assemble", "--branch", "1")
    # five hinges about parallel axes and one loop: 5 - 3 degrees of freedom, less the hinge that is the closure
    assert answer("info", str(path))["mobility"] == 4 - 2


def test_what_cannot_close_says_by_how_much(tmp_path: Path, run: Any) -> None:
    """Four bars of 1 m between pivots 5 m apart leave at least 1 m open."""
    path = _two_arms(tmp_path, 5.0)
    trial = closing_trial(Robot.load(path))
    assert trial.closed == 0
    (gap,) = trial.gaps.values()
    assert gap == pytest.approx(1.0, rel=1e-6)
    assert "from 30 random starts none closes: the nearest end leaves open tip_a-tip_b by 1 m or rad" in str(trial)
    with pytest.raises(ConvergenceError, match=r"from 120 random starts none closes.*tip_a-tip_b by 1 m"):
        assembled_homes(Robot.load(path))
    assert str(trial) in run("info", str(path)).stdout
    done = run("fk", "--robot", str(path), "--configuration", "home", "--tool-frame", "a2")
    assert done.returncode == 1
    assert "--assemble" in done.stderr


LEG = (
    '<body name="arm{0}" pos="{1} {2} 0"><joint name="p{0}" axis="0 0 1"/><geom size=".01"/><body name="rod{0}">'
    '<joint name="d{0}" type="slide" axis="1 0 0" range="0.1 0.6"/><geom size=".01"/><site name="e{0}"/></body></body>'
)
PLATE = (
    '<body name="plate" pos="0.28 0.2 0"><joint name="x" type="slide" axis="1 0 0"/>'
    '<joint name="y" type="slide" axis="0 1 0"/><joint name="phi" axis="0 0 1"/><geom size="0.05"/><site name="tool"/>'
    '<site name="c1" pos="-0.06 -0.04 0"/><site name="c2" pos="0.07 -0.03 0"/><site name="c3" pos="0.01 0.08 0"/>'
    "</body>"
)
BASE, PLATFORM = np.array([[0, 0], [0.6, 0.05], [0.25, 0.55]]), np.array([[-0.06, -0.04], [0.07, -0.03], [0.01, 0.08]])


def test_homes_on_both_sides_of_a_three_rpr_are_far_from_its_singular_poses(
    tmp_path: Path, answer: Any, run: Any
) -> None:
    """The sides are told apart by the sign of det J, J = d(lengths) / d(x, y, phi), here from the drawing."""
    legs = "".join(LEG.format(k + 1, *point) for k, point in enumerate(BASE))
    ties = "".join(f'<connect site1="e{k}" site2="c{k}"/>' for k in (1, 2, 3))
    drives = "".join(f'<motor joint="d{k}"/>' for k in (1, 2, 3))
    path = tmp_path / "rpr.xml"
    path.write_text(
        f'<mujoco model="rpr"><compiler angle="radian"/><worldbody>{legs}{PLATE}</worldbody><equality>{ties}</equality>'
        f"<actuator>{drives}</actuator></mujoco>"
    )
    assert "home breaks limits: d2 = -0.3758 (0.1 .. 0.6)" in run("info", str(path)).stdout
    homes, determinants = assembled_homes(Robot.load(path)), []
    for home in homes:
        x, y, phi = (home.configuration.joint_position(name) for name in ("x", "y", "phi"))
        turned = PLATFORM @ np.array([[np.cos(phi), np.sin(phi)], [-np.sin(phi), np.cos(phi)]])
        struts = np.array([0.28 + x, 0.2 + y]) + turned - BASE
        lengths = np.linalg.norm(struts, axis=1)
        assert home.configuration.commands == pytest.approx(lengths, abs=1e-9)
        moments = turned[:, 0] * struts[:, 1] - turned[:, 1] * struts[:, 0]
        determinants.append(np.linalg.det(np.column_stack([struts, moments]) / lengths[:, None]))
        assert home.within_limits
    # random poses of the platform over the middle of the base have a median |det J| of 0.09
    assert len(homes) == 2
    assert determinants[0] * determinants[1] < 0.0
    assert min(map(abs, determinants)) > 0.02
    answer("info", str(path), "--assemble", "--branch", "2")
    chosen = homes[1].configuration.commands
    assert answer("ik", "--robot", str(path), *map(str, chosen))["within_limits"] is True


@pytest.mark.parametrize(("size", "starts"), [(4, 120), (50, 30)])
def test_large_robots_are_assembled_from_fewer_starts(
    size: int, starts: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As often around the described home as within limits, where none closes; a lift of n has 2 n + 2 joints."""
    robot = Robot.load(scissor(size).write(tmp_path / "robot"))
    tried: list[Any] = []

    def assemble(robot: Robot, q: Any) -> Assembly:
        tried.append(q)
        return Assembly(False, 0, 1.0, robot, q, np.zeros((0, 0)))

    monkeypatch.setattr(assemblies, "assemble", assemble)
    with pytest.raises(ConvergenceError, match=f"from {starts} random starts none closes"):
        assembled_homes(robot)
    assert len(tried) == 2 * starts
