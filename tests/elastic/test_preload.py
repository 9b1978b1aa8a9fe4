"""Preload of redundant drives against struts that can be done by hand, and against differences of equilibria."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import pm3dof_pin as pm
from pm3dof_pin.cli.app import app
from pm3dof_pin.elastic.loaded import loaded_equilibrium
from pm3dof_pin.elastic.preload import preload
from pm3dof_pin.exceptions import InvalidValueError

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts" / "benchmarks"))
from families import Drawing, legs

LENGTH, STIFFNESS = 0.2, 1e7


@pytest.fixture(scope="module")
def three_struts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A point in a plane on three struts at 120 degrees, each with a driven slide of 1e7 N/m."""
    drawing = Drawing("three_struts")
    link = drawing.joint("base", "px", kind="prismatic", axis=(1.0, 0.0, 0.0))
    drawing.tool = drawing.joint(link, "py", kind="prismatic", axis=(0.0, 1.0, 0.0))
    for k in range(3):
        angle = 0.4 + 2.0 * math.pi * k / 3
        foot = (LENGTH * math.cos(angle), LENGTH * math.sin(angle), 0.0)
        strut = drawing.joint("base", f"turn{k}", foot, (0.0, 0.0, angle + math.pi), "revolute")
        rod = drawing.joint(strut, f"slide{k}", kind="prismatic", axis=(1.0, 0.0, 0.0))
        drawing.close(rod, (LENGTH, 0.0, 0.0), drawing.tool, (0.0, 0.0, 0.0))
        drawing.drives.append(f"slide{k}_joint")
    return drawing.write(tmp_path_factory.mktemp("struts"))


@pytest.mark.parametrize("force", [-1e6, 2e5, 1e6])
def test_struts_in_tension_are_stiffer_and_in_compression_softer(three_struts: Path, force: float) -> None:
    """A strut of stiffness k, length L and tension T resists across by T / L: three give 3 / 2 (k + T / L)."""
    model = pm.ElasticModel.load(three_struts)
    home = model.rigid.home
    loads = preload(model, home, {"slide1_joint": force})
    np.testing.assert_allclose(list(loads.efforts.values()), force, rtol=1e-12)
    loaded = loaded_equilibrium(model, home, loads)
    expected = 1.5 * (STIFFNESS - force / LENGTH)
    compliance = loaded.tangent_compliance()
    np.testing.assert_allclose(compliance[:2, :2], np.eye(2) / expected, rtol=1e-9, atol=1e-9 / expected)
    assert loaded.least_eigenvalue == pytest.approx(1.0 - force / (STIFFNESS * LENGTH), rel=1e-9)
    assert loaded.displacement() == pytest.approx(0.0, abs=1e-12)


def test_the_command_prints_the_stiffness_under_preload(three_struts: Path) -> None:
    arguments = ["stiffness", "--robot", str(three_struts), "--configuration", "home", "--preload", "slide0_joint=-1e6"]
    result = CliRunner().invoke(app, [*arguments, "--json"])
    assert result.exit_code == 0, result.output
    printed = json.loads(result.stdout)
    expected = 1.5 * (STIFFNESS + 1e6 / LENGTH)
    assert printed["felt"]["x"] == pytest.approx(expected, rel=1e-9)
    np.testing.assert_allclose(printed["free_motion_stiffness"], expected * np.eye(2), atol=1e-6 * expected)
    assert printed["preload"] == pytest.approx({f"slide{k}_joint": -1e6 for k in range(3)}, rel=1e-9)
    lines = CliRunner().invoke(app, arguments).stdout
    assert "preload" in lines
    assert "least eigenvalue 1.5" in lines


def test_eight_legs_against_differences_of_equilibria(tmp_path: Path) -> None:
    """Compliance under preload by central differences of the equilibria in small further wrenches."""
    model = pm.ElasticModel.load(legs(8).write(tmp_path))
    home, tool = model.rigid.home, model.rigid.frame_name()
    loads = preload(model, home, {"s0_joint": -4e5, "s1_joint": -3e5})
    slides = [loads.efforts[f"s{k}_joint"] for k in range(8)]
    rates = pm.jacobian(model.rigid, home, of="commands", by="tool").values
    assert np.abs(rates.T @ slides).max() < 1e-6 * np.abs(slides).max()
    loaded = loaded_equilibrium(model, home, loads)
    step, columns = 20.0, []
    for axis in np.eye(6):
        ends = [
            loaded_equilibrium(model, home, pm.Loads({tool: sign * step * axis}, efforts=loads.efforts)).displacement()
            for sign in (-1.0, 1.0)
        ]
        columns.append((ends[1] - ends[0]) / (2.0 * step))
    found, plain = loaded.tangent_compliance(), pm.compliance(model, home.q)
    scale = np.sqrt(np.outer(np.diag(plain), np.diag(plain)))
    assert np.abs((found - np.stack(columns, axis=1)) / scale).max() < 1e-5
    assert np.abs((found - plain) / scale).max() > 1e-2


def test_forces_that_cannot_balance_are_refused(three_struts: Path) -> None:
    hexapod, struts = pm.ElasticModel.load("hexapod"), pm.ElasticModel.load(three_struts)
    home = hexapod.rigid.home
    with pytest.raises(InvalidValueError, match="6 drives move 6 degrees of freedom"):
        preload(hexapod, home, {hexapod.rigid.actuated_joints[0]: 100.0})
    with pytest.raises(InvalidValueError, match="an actuated joint of three_struts"):
        preload(struts, struts.rigid.home, {"turn0_joint": 1.0})
    with pytest.raises(InvalidValueError, match="3 drives move 2"):
        preload(struts, struts.rigid.home, {"slide0_joint": 1.0, "slide1_joint": -1.0})
