"""The READMEs of the machines other than the tripod: their numbers are recomputed, their examples run."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.description.robots import robot_names, robots_directory
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.kinematics.actuation import independent_motions
from pm3dof_pin.kinematics.robot import Robot

ROBOTS = ("hexapod", "linear_delta", "three_rps")


def _readme(robot: str) -> str:
    return (robots_directory() / f"{robot}_description" / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_examples_run(robot: str, capsys: pytest.CaptureFixture[str]) -> None:
    examples = re.findall(r"```python\n(.*?)```", _readme(robot), flags=re.DOTALL)
    assert examples
    for example in examples:
        exec(compile(example, f"README.md of {robot}", "exec"), {})
    assert "e-0" in capsys.readouterr().out


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_picture_and_the_neighbours_are_there(robot: str) -> None:
    folder = Path(__file__).parents[2] / "robots" / f"{robot}_description"
    links = re.findall(r"\]\(([^)#]+)", _readme(robot))
    assert any(link.endswith(".png") for link in links)
    for link in links:
        assert (folder / link).resolve().is_file(), link


@pytest.mark.parametrize("robot", robot_names())
def test_the_table_of_files_is_complete(robot: str) -> None:
    folder = robots_directory() / f"{robot}_description"
    table = "".join(line for line in _readme(robot).splitlines() if line.startswith("| `"))
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.name != "README.md" and "__pycache__" not in path.parts:
            name = path.relative_to(folder).as_posix()
            inside = f"`{path.relative_to(folder).parts[0]}/`" if "/" in name else name
            kind = f"{path.parent.relative_to(folder).as_posix()}/*{path.suffix}"
            braced = name.replace(path.suffix, ".{urdf,yaml}")
            assert any(entry in table for entry in (name, inside, kind, braced)), name


def test_the_hexapods_table_of_compliance() -> None:
    elastic = ElasticModel.load("hexapod")
    compliance = cartesian_compliance(elastic, elastic.rigid.home).compliance
    column = re.findall(r"^\| [^|]+ \| [^|]+ \| ([-\d.e]+).* \|$", _readme("hexapod"), flags=re.MULTILINE)
    assert [f"{compliance[i]:.5e}".replace("e-0", "e-") for i in ((0, 0), (2, 2), (3, 3), (5, 5), (0, 4))] == column


def test_the_beam_machines_compliance() -> None:
    elastic = ElasticModel.load("three_rps")
    diagonal = cartesian_compliance(elastic, elastic.rigid.home).compliance.diagonal()
    x, z = (f"{diagonal[i]:.5e}".replace("e-0", "e-") for i in (0, 2))
    assert (
        f"is {diagonal[0] / diagonal[2]:.0f} times more compliant sideways than along z, {x} against {z} m/N"
        in _readme("three_rps")
    )


@pytest.mark.parametrize(("robot", "digits"), [("hexapod", 7), ("linear_delta", 5), ("three_rps", 5)])
def test_holding_forces_at_home(robot: str, digits: int) -> None:
    """Virtual power: the actuators' forces f hold the weight, A^T f = V^T g; every leg carries the same."""
    mechanism = Robot.load(robot)
    weight = pin.computeGeneralizedGravity(mechanism.model, mechanism.model.createData(), mechanism.home.q)
    forces = np.linalg.solve(
        independent_motions(mechanism.home)[mechanism.home.mechanism.actuated_indices].T,
        independent_motions(mechanism.home).T @ weight,
    )
    np.testing.assert_allclose(forces, forces[0], rtol=1e-9)
    assert f"{forces[0]:.{digits}f} N" in _readme(robot)
