"""Exported functions against Pinocchio's solver, and their derivatives against the robots' Jacobians."""

from __future__ import annotations

import ctypes
import importlib.util
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import pm3dof_pin as pm
from pm3dof_pin.dynamics.modes import natural_modes
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.exceptions import InvalidValueError, PM3DofError, ProgramError
from pm3dof_pin.export import function_quantities, functions
from pm3dof_pin.export.controllers import export_controller
from pm3dof_pin.export.function_quantities import KINEMATICS, QUANTITIES
from pm3dof_pin.export.functions import export_functions
from pm3dof_pin.kinematics.closing_programs import ProgramSource
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.programs import cache, llvm
from pm3dof_pin.programs.walk import Walk

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts" / "benchmarks"))
from families import stacked

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
        assert np.abs(module.jit(differentiate(module.commands))(given) - rates.values).max() < 1e-12
    assert np.abs(module.jit(jax.jacfwd(jax.jacfwd(module.commands)))(given) - rates.derivatives).max() < 1e-9
    back = module.jit(jax.jacfwd(module.coordinates))(jax.numpy.array(pose.commands))
    assert np.abs(back @ rates.values - np.eye(3)).max() < 1e-11
    batch = module.jit(jax.vmap(module.commands))(jax.numpy.tile(given, (4, 5, 1)))
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
    refusals = {
        "transform": "no tool frame",
        "compliance": "no springs",
        "stiffnes": "stiffness",
        "tool_by_commands": "tool_frame",
        "commands_by_nothing": "nothing",
    }
    for name, words in refusals.items():
        with pytest.raises(PM3DofError, match=words):
            export_functions(loaded("ankle"), [name], "numpy", tmp_path)
    with pytest.raises(InvalidValueError, match="stiffness of ankle_rus"):
        export_functions(pm.load("ankle_rus"), ["stiffness"], "numpy", tmp_path)  # rigid in some direction


@pytest.mark.parametrize(
    ("name", "to"),
    [
        ("five_bar", "numpy"),
        ("ankle_rus", "numpy"),
        ("ankle", "torch"),
        ("five_bar", "torch"),
        ("five_bar", "casadi"),
        ("three_rpr", "numpy"),
    ],
)
def test_every_quantity(name: str, to: str, exported: Exported) -> None:
    if to != "numpy":
        pytest.importorskip(to)
    robot = loaded(name)
    differences = exported(robot, ["all"], to)._selftest()
    assert max(differences.values()) < 1e-11
    expected = {"commands", "coordinates", "jacobian", "joints_by_commands", "mass_matrix", "coordinate_weight"}
    if robot.tool_frame is not None:
        expected |= {"transform", "tool_by_commands", "vibrations", "error_sensitivities", "constraint_jacobian"}
        expected |= {"geometric_error", "geometric_error_bound", "geometric_error_left"}
    if robot.springs:
        expected |= {"compliance", "axis_compliance", "principal_stiffness", "compliance_by_spring"}
    assert expected <= set(differences)


def test_quantities_are_described_once_and_not_compiled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    described, compiled = list[str](), list[Any]()
    describe, code = function_quantities.describe_quantity, llvm.object_code

    def noted(robot: pm.Robot, name: str) -> function_quantities.Described:
        described.append(name)
        return describe(robot, name)

    monkeypatch.setenv("PM3DOF_CACHE_DIR", "")
    monkeypatch.setattr(cache, "_known", {})
    monkeypatch.setattr(function_quantities, "describe_quantity", noted)
    monkeypatch.setattr(functions, "describe_quantity", noted)
    monkeypatch.setattr(llvm, "object_code", lambda program, *rest: compiled.append(program) or code(program, *rest))
    export_functions(loaded("five_bar"), ["all"], "numpy", tmp_path)
    assert set(QUANTITIES) <= set(described)
    assert len(described) == len(set(described))
    assert {each.name for each in compiled if not isinstance(each, Walk)} <= {"checks"}


def test_every_quantity_with_jax(exported: Exported) -> None:
    jax = pytest.importorskip("jax")
    module = exported(loaded("four_bar"), ["all"], "jax")
    (at_commands, coordinates, _), (given, *_) = module._GOLDEN["coordinates"], module._GOLDEN["commands"]
    names = [name for name in module._GOLDEN if name != "coordinates"]
    assert {"compliance", "holding_forces", "vibrations", "tool_by_commands"} <= set(names)
    found = module.jit(lambda x: [getattr(module, name)(x) for name in names])(jax.numpy.array(given))
    for name, values in zip(names, found, strict=True):
        _, wanted, scale = module._GOLDEN[name]
        np.testing.assert_allclose(values, np.array(wanted), rtol=0.0, atol=1e-11 * scale, err_msg=name)
    np.testing.assert_allclose(module.coordinates(at_commands), coordinates, atol=1e-12)


def test_every_quantity_in_c(tmp_path: Path) -> None:
    compiler = shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("no C compiler")
    files = [file for file in export_functions(loaded("five_bar"), ["all"], "c", tmp_path) if "five_bar_" in file.name]
    sources = [file for file in files if file.suffix == ".c"]
    options = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-O1", "-shared", "-fPIC", "-o")
    subprocess.run([compiler, *options, tmp_path / "all.so", *sources, "-lm"], check=True)
    library, worst = ctypes.CDLL(str(tmp_path / "all.so")), ctypes.c_double()
    assert len(sources) > 15
    for file in sources:
        assert library[f"{file.stem}_selftest"](ctypes.byref(worst)) == 0, file.stem
        assert worst.value < 1e-11, file.stem


def test_natural_frequencies_from_their_program(exported: Exported) -> None:
    robot = loaded("five_bar")
    module = exported(robot, ["vibrations"], "numpy")
    pose = robot.solve(module._GOLDEN["vibrations"][0][0])
    squares = np.linalg.eigvalsh(module.vibrations(pose.coordinates))[::-1]
    wanted = natural_modes(ElasticModel(robot), pose.q, count=3).frequencies
    np.testing.assert_allclose(1.0 / (2.0 * np.pi * np.sqrt(squares[: len(wanted)])), wanted, rtol=1e-9)


def test_a_robot_without_programs_is_told_what_answers_instead(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "MOST_OPERATIONS", 10)
    with pytest.raises(ProgramError, match=r"more than the 10 compiled: .*Robot\.solve.*engine='pinocchio'"):
        export_functions(pm.load("three_rps"), ["commands"], "numpy", tmp_path)
    assert not list(tmp_path.iterdir())


def test_the_page_and_the_help_name_every_quantity(run: Callable[..., Any]) -> None:
    page = (Path(__file__).parents[2] / "docs" / "commands" / "files.md").read_text(encoding="utf-8")
    text = run("export", "function", "--of", "nothing").stderr
    for name in (*KINEMATICS, *QUANTITIES):
        assert f"`{name}`" in page
        assert name in text


def test_drives_that_coordinates_leave_open_are_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two hexapods on top of each other: six coordinates of the tool, and six drives each."""
    robot = pm.load(stacked(2).write(tmp_path / "robot"))
    monkeypatch.setattr(ProgramSource, "walk", None)  # the work
    words = "12 independent drives, which 6 coordinates do not determine"
    with pytest.raises(InvalidValueError, match=words):
        export_controller(robot, "c", tmp_path / "c")
    for of in ("all", "compliance"):
        with pytest.raises(InvalidValueError, match=words):
            export_functions(robot, [of], "numpy", tmp_path / of)
