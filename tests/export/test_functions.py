"""Exported functions against Pinocchio's solver, and their derivatives against the robots' Jacobians."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import pm3dof_pin as pm
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.export.functions import export_functions
from pm3dof_pin.kinematics.reachable_poses import reachable_poses

MACHINES = Path(__file__).parents[1] / "machines"
Exported = Callable[..., ModuleType]


@pytest.fixture
def exported(tmp_path: Path) -> Exported:
    def load(robot: pm.Robot, of: list[Any], to: Any) -> ModuleType:
        (file,) = export_functions(robot, of, to, tmp_path)
        spec = importlib.util.spec_from_file_location(file.stem, file)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    return load


def loaded(name: str) -> pm.Robot:
    return pm.load(MACHINES / name if (MACHINES / name).is_dir() else name)


@pytest.mark.parametrize("name", ["pm3dof", "hexapod", "delta", "four_rrr", "five_bar"])
def test_arrays_of_poses_with_numpy(name: str, exported: Exported) -> None:
    robot = loaded(name)
    module = exported(robot, ["commands", "coordinates", "transform", "jacobian"], "numpy")
    assert max(module._selftest().values()) < 1e-12
    poses = reachable_poses(robot, 60, np.random.default_rng(9))
    wanted = robot.solve(poses.coordinates, guess=poses.q, engine="pinocchio").reshape(3, 20)
    given = wanted.coordinates
    found, back = module.commands(given), module.coordinates(wanted.commands)
    reached = np.isfinite(found).all(axis=-1) & np.isfinite(back).all(axis=-1)
    assert reached.mean() > (0.7 if name == "four_rrr" else 0.999)  # straight lines from home do not reach all
    assert np.abs(found - wanted.commands)[reached].max() < 1e-12
    assert np.abs(back - given)[reached].max() < 1e-11
    assert np.abs(module.transform(given) - wanted.transforms)[reached].max() < 1e-12
    rates = pm.jacobian(robot, wanted, of="commands", by="coordinates").values
    assert np.abs(module.jacobian(given) - rates)[reached].max() < 1e-9 * np.abs(rates).max()
    assert module.commands(given[0, 0]).shape == (len(robot.commands),)


def test_compliance_with_numpy_and_poses_out_of_reach(exported: Exported) -> None:
    robot = pm.load("pm3dof")
    module = exported(robot, ["commands", "compliance"], "numpy")
    poses = robot.solve([[0.1, -0.2, 0.5], [0.2, 0.1, 0.48]])
    wanted = pm.compliance(robot, poses, engine="pinocchio")
    assert np.abs(module.compliance(poses.coordinates) - wanted).max() < 1e-12 * np.abs(wanted).max()
    found = module.commands([[0.0, 0.0, 3.0], [0.0, 0.0, 0.5]])
    assert np.isnan(found[0]).all()
    assert np.isfinite(found[1]).all()


def test_derivatives_with_jax(exported: Exported) -> None:
    jax = pytest.importorskip("jax")
    robot = pm.load("pm3dof")
    module = exported(robot, ["commands", "coordinates"], "jax")
    assert max(module._selftest().values()) < 1e-12
    pose = robot.solve([0.1, -0.2, 0.5])
    rates = pm.jacobian(robot, pose, of="commands", by="coordinates", with_derivatives=True)
    given = jax.numpy.array(pose.coordinates)
    for differentiate in (jax.jacfwd, jax.jacrev):
        assert np.abs(differentiate(module.commands)(given) - rates.values).max() < 1e-12
    assert np.abs(jax.jacfwd(jax.jacfwd(module.commands))(given) - rates.derivatives).max() < 1e-9
    back = jax.jacfwd(module.coordinates)(jax.numpy.array(pose.commands))
    assert np.abs(back @ rates.values - np.eye(3)).max() < 1e-11
    batch = jax.jit(module.commands)(jax.numpy.tile(given, (4, 5, 1)))
    assert np.abs(batch - pose.commands).max() < 1e-14


def test_derivatives_with_casadi(exported: Exported) -> None:
    casadi = pytest.importorskip("casadi")
    robot = pm.load("pm3dof")
    module = exported(robot, ["commands", "coordinates", "jacobian", "compliance"], "casadi")
    assert max(module._selftest().values()) < 1e-12
    pose = robot.solve([0.1, -0.2, 0.5])
    rates = pm.jacobian(robot, pose, of="commands", by="coordinates", with_derivatives=True)
    x = casadi.MX.sym("x", 3)
    first = casadi.jacobian(module.commands(x), x)
    found = casadi.Function("rates", [x], [first, casadi.jacobian(casadi.vec(first), x)])(pose.coordinates)
    assert np.abs(np.array(found[0]) - rates.values).max() < 1e-12
    second = np.array(found[1]).reshape(3, 3, 3, order="F").transpose(0, 1, 2)
    assert np.abs(second - rates.derivatives).max() < 1e-9


def test_derivatives_with_torch(exported: Exported) -> None:
    torch = pytest.importorskip("torch")
    robot = pm.load("pm3dof")
    module = exported(robot, ["commands", "coordinates", "jacobian"], "torch")
    assert max(module._selftest().values()) < 1e-12
    pose = robot.solve([0.1, -0.2, 0.5])
    rates = pm.jacobian(robot, pose, of="commands", by="coordinates").values
    differentiate = torch.autograd.functional.jacobian
    found = differentiate(module.commands, torch.tensor(pose.coordinates)).numpy()
    assert np.abs(found - rates).max() < 1e-12
    back = differentiate(module.coordinates, torch.tensor(pose.commands)).numpy()
    assert np.abs(back @ rates - np.eye(3)).max() < 1e-11


def test_c_and_refusals(tmp_path: Path) -> None:
    files = export_functions(pm.load("pm3dof"), ["commands", "compliance"], "c", tmp_path)
    assert [file.name for file in files] == ["pm3dof.h", "pm3dof.c", "pm3dof_parameters.h", "pm3dof_compliance.c"]
    with pytest.raises(InvalidValueError, match="no tool frame"):
        export_functions(loaded("ankle"), ["compliance"], "numpy", tmp_path)
    with pytest.raises(InvalidValueError, match="stiffness"):
        export_functions(pm.load("pm3dof"), ["stiffness"], "numpy", tmp_path)  # type: ignore[list-item]
