"""Turning and moving a robot's base: the same poses, results and doubt, in the axes of the base."""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pm3dof_pin as pm
from pm3dof_pin.description.robots import robot_names, robots_directory
from pm3dof_pin.dynamics.batch import drive_mass_matrices
from pm3dof_pin.dynamics.motion_dynamics import motion_dynamics, motion_dynamics_program
from pm3dof_pin.elastic.quantities import COMPLIANCE
from pm3dof_pin.elastic.traced import traced_program
from pm3dof_pin.errors.error_parameters import all_parameters
from pm3dof_pin.errors.sensitivity import closable
from pm3dof_pin.kinematics.branches import samples_near_home
from pm3dof_pin.kinematics.jacobian_programs import jacobian_program
from pm3dof_pin.kinematics.jacobians import motion_rates
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.programs.closing import Task, closing_program
from pm3dof_pin.programs.llvm import Compiled

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts" / "benchmarks"))
from families import four_bars, scissor

MACHINES = Path(__file__).parents[1] / "machines"
FOLDERS = {name: robots_directory() / f"{name}_description" for name in robot_names()}
FOLDERS |= {path.name: path for path in sorted(MACHINES.iterdir()) if (path / f"{path.name}.urdf").exists()}
DRAWN = {"chain of four-bars": (four_bars, 4), "scissor lift": (scissor, 2)}
ANGLES, SHIFT = (0.3, -0.7, 1.1), (0.3, -0.2, 0.5)


def on_stand(name: str, angles: tuple[float, ...], shift: tuple[float, ...]) -> Robot:
    """Load a robot whose root link is fixed to a stand, by a joint with this placement."""
    with TemporaryDirectory() as temporary:
        folder = Path(temporary) / name
        if name in DRAWN:
            draw, size = DRAWN[name]
            draw(size).write(folder)
        else:
            folder = Path(shutil.copytree(FOLDERS[name], folder.with_name(FOLDERS[name].name)))
        for path in folder.rglob("*.urdf"):
            text = path.read_text(encoding="utf-8")
            links, children = (set(re.findall(rf'<{tag}="([^"]+)"', text)) for tag in ("link name", "child link"))
            (root,) = links - children
            place = f'xyz="{" ".join(map(repr, shift))}" rpy="{" ".join(map(repr, angles))}"'
            joint = f'<parent link="stand"/><child link="{root}"/><origin {place}/>'
            stand = f'<link name="stand"/><joint name="stand_joint" type="fixed">{joint}</joint></robot>'
            path.write_text(text.replace("</robot>", stand), encoding="utf-8")
        return Robot.load(folder)


def results(name: str, angles: tuple[float, ...], shift: tuple[float, ...]) -> tuple[dict[str, Any], dict[str, int]]:
    """Return results at random poses, in the axes of the root link; and the numbers of doubtful poses."""
    robot = on_stand(name, angles, shift)
    commands, home = robot.command_coordinates, np.asarray(robot.home.commands)
    widths = [0.1 * robot.characteristic_length if c.unit == "m" else 0.1 for c in commands]
    values = home + np.random.default_rng(0).uniform(-1.0, 1.0, (1100, len(home))) * widths
    if name == "four_rrr":  # four drives of three degrees of freedom
        plain = on_stand(name, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        poses = robot.at(plain.solve(plain.home_coordinates + 0.1 * (values[:, :3] - home[:3])).q)
    else:
        poses = robot.forward(values, on_failure="nan")
    found, turn = {"q": poses.q}, np.kron(np.eye(2), pin.rpy.rpyToMatrix(*angles))
    poses = poses[poses.solved]
    doubtful: dict[str, int] = {}
    with_doubt = Compiled.with_doubt

    def noted(compiled: Compiled, *args: Any, **options: Any) -> tuple[Any, Any]:
        outputs, sound = with_doubt(compiled, *args, **options)
        doubtful[compiled.program.name] = int((~sound).sum())
        return outputs, sound

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Compiled, "with_doubt", noted)
        if robot.springs:
            found["compliance"] = turn.T @ pm.compliance(robot, poses) @ turn
        found["mass matrix"] = drive_mass_matrices(robot, poses)
        found["inertia"] = motion_dynamics(robot, poses, by="commands").inertia
        if robot.tool_frame is not None:
            tool = pm.jacobian(robot, poses, of="tool", by="commands", with_derivatives=True)
            assert tool.derivatives is not None
            found["tool"] = turn.T @ tool.values
            found["accelerations of the tool"] = np.einsum("ji,njkl->nikl", turn, tool.derivatives)
        if name != "four_rrr":
            errors = closable(pm.GeometricErrors(robot, all_parameters(robot)), robot.at([robot.home.q]))
            found["errors"] = turn.T @ pm.sensitivities(errors, poses).errors
    return found, doubtful


@pytest.mark.usefixtures("programs_for_few_poses")
@pytest.mark.parametrize("name", [*FOLDERS, *DRAWN])
def test_results_and_doubt_do_not_depend_on_where_the_base_stands(name: str) -> None:
    """A closure that is redundant in a plane must be so in any: its rows are rounding errors, not zeros."""
    found, doubtful = results(name, ANGLES, SHIFT)
    expected, before = results(name, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert doubtful
    assert doubtful == before == dict.fromkeys(doubtful, 0)
    assert set(found) == set(expected)
    for key, values in expected.items():
        np.testing.assert_allclose(found[key], values, rtol=0, atol=1e-11 * np.nanmax(np.abs(values)), err_msg=key)


@pytest.mark.parametrize("name", DRAWN)
def test_programs_of_a_turned_robot_are_as_short(name: str) -> None:
    """Planar loops stay planar in the axes of the first joint; only tool, weight and moments of inertia are turned."""
    lengths = []
    for angles, shift in (((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), (ANGLES, SHIFT)):
        model = pm.ElasticModel(on_stand(name, angles, shift))
        robot = model.rigid
        task = Task.from_coordinates(robot.command_coordinates)
        closing = closing_program(robot, task, samples_near_home(robot))
        compliance = traced_program(model, robot.frame_name(), "compliance", COMPLIANCE.traced)
        rates = [motion_rates(robot, way, name) for way, name in (("of", "joints"), ("by", "commands"))]
        jacobian = jacobian_program(robot, *rates, samples_near_home(robot), with_derivatives=True)
        inertia = motion_dynamics_program(robot, "commands").compiled.program
        lengths.append((len(closing), len(compliance), len(jacobian), len(inertia)))
    straight, turned = np.array(lengths)
    assert (turned < np.array([1.1, 1.1, 1.3, 1.3]) * straight).all()
