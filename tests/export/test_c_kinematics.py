"""C for controllers, compiled without warnings and run: against Pinocchio's solver, finite differences and limits."""

from __future__ import annotations

import ctypes
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pm3dof_pin as pm
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.export.c_kinematics import c_files
from pm3dof_pin.export.controller import Controller
from pm3dof_pin.export.controllers import export_controller, placed_by_tool, with_regular_home
from pm3dof_pin.kinematics.reachable_poses import reachable_poses

MACHINES = Path(__file__).parents[1] / "machines"
STRICT = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror")
ROBOTS = ("pm3dof", "hexapod", "linear_delta", "three_rps", "delta", "four_bar", "four_rrr", "five_bar", "three_rpr")
OK, BEYOND, OPEN, NO_NUMBER, CONTRADICTION = 0, 1, 2, 3, 5


@cache
def controller(name: str) -> Controller:
    return Controller(pm.load(MACHINES / name if (MACHINES / name).is_dir() else name))


class Library:
    """Exported C, compiled by gcc and called through ctypes."""

    def __init__(self, described: Controller, folder: Path, model: str = "nominal", **options: Any) -> None:
        compiler = shutil.which("gcc") or shutil.which("clang")
        if compiler is None:
            pytest.skip("no C compiler")
        single = options.get("real") == "float"
        self.dtype, self.number = (np.float32, ctypes.c_float) if single else (np.float64, ctypes.c_double)
        for name, text in c_files(described, **options).items():
            (folder / name).write_text(text, encoding="utf-8")
        name, library = described.name, folder / f"{described.name}.so"
        source = folder / f"{name}.c"
        subprocess.run([compiler, *STRICT, "-O1", "-shared", "-fPIC", source, "-o", library, "-lm"], check=True)
        loaded, self.robot = ctypes.CDLL(str(library)), described.robot
        self.functions = {
            function: getattr(loaded, f"{name}_{function}", None)
            for function in ("start", "inverse", "forward", "jacobian", "limits", "tool", "selftest")
        }
        self.model = (ctypes.c_char * 1).in_dll(loaded, f"{name}_{model}")
        sizes = len(self.robot.commands), len(self.robot.coordinates)
        self.k, self.m = sizes
        fields = [("q", self.number * described.inverse.nq), ("commands", self.number * self.k)]
        fields += [("before", self.number * described.inverse.nq * 2), ("n_before", ctypes.c_int)]
        counters = [("is_started", ctypes.c_int), ("steps", ctypes.c_int), ("walks", ctypes.c_int)]
        self.state = type("State", (ctypes.Structure,), {"_fields_": [*fields, *counters]})()

    def _call(self, function: str, given: Any, shape: tuple[int, ...]) -> tuple[int, np.ndarray]:
        out = np.full(shape, 77.0, dtype=self.dtype)
        arguments = [] if given is None else [np.ascontiguousarray(given, dtype=self.dtype)]
        pointers = [ctypes.c_void_p(array.ctypes.data) for array in (*arguments, out)]
        status = self.functions[function](ctypes.byref(self.model), ctypes.byref(self.state), *pointers)
        return status, out

    def inverse(self, coordinates: Any) -> tuple[int, np.ndarray]:
        return self._call("inverse", coordinates, (self.k,))

    def forward(self, commands: Any) -> tuple[int, np.ndarray]:
        return self._call("forward", commands, (self.m,))

    def jacobian(self) -> tuple[int, np.ndarray]:
        return self._call("jacobian", None, (self.k, self.m))

    def tool(self) -> np.ndarray:
        return self._call("tool", None, (4, 4))[1]

    def limits(self) -> int:
        return int(self.functions["limits"](ctypes.byref(self.model), ctypes.byref(self.state)))

    def selftest(self) -> tuple[int, float]:
        worst = self.number()
        return self.functions["selftest"](ctypes.byref(self.model), ctypes.byref(worst)), worst.value


@pytest.fixture
def library(tmp_path: Path) -> Callable[..., Library]:
    return lambda name, **options: Library(controller(name), tmp_path, **options)


def scales(robot: Any) -> np.ndarray:
    return np.array([abs(command.scale) for command in robot.commands])


@pytest.mark.parametrize("name", ROBOTS)
def test_both_directions_as_pinocchio_solves_them(name: str, library: Callable[..., Library]) -> None:
    compiled = library(name)
    robot = compiled.robot
    assert compiled.selftest()[0] == 0
    assert compiled.selftest()[1] < 1e-12
    generator = np.random.default_rng(5)
    around = generator.uniform(-0.04, 0.04, (6, compiled.m))
    sizes = [robot.characteristic_length if c.unit == "m" else 1.0 for c in robot.coordinates]
    for values in robot.home_coordinates + around * sizes:
        expected = robot.solve(values, engine="pinocchio")
        status, commands = compiled.inverse(values)
        assert status == OK
        assert np.allclose(commands / scales(robot), expected.commands / scales(robot), rtol=0.0, atol=1e-11)
        status, back = compiled.forward(expected.commands)
        assert status == OK
        assert np.allclose(back, values, rtol=0.0, atol=1e-11)
        assert np.allclose(compiled.tool(), expected.transforms, rtol=0.0, atol=1e-11)
        jacobian = pm.jacobian(robot, expected, of="commands", by="coordinates").values
        status, found = compiled.jacobian()
        assert status == OK
        assert np.allclose(found / scales(robot)[:, None], jacobian / scales(robot)[:, None], rtol=0.0, atol=1e-8)


def test_an_arm_that_is_singular_at_home_starts_elsewhere_and_goes_by_waypoints(tmp_path: Path) -> None:
    arm = pm.load("ur5", tool_frame="tool0")
    placed = with_regular_home(placed_by_tool(arm))
    assert not np.allclose(placed.home.q, arm.home.q)
    compiled = Library(Controller(placed), tmp_path)
    failed, worst = compiled.selftest()
    assert failed == 0
    assert 0.0 < worst < 1e-12
    poses = reachable_poses(placed, 200, np.random.default_rng(3))
    found = 0
    for values, transform in zip(poses.coordinates, poses.transforms, strict=True):
        compiled.state.is_started = 0
        status, commands = compiled.inverse(values)
        assert status in (OK, OPEN)
        if status == OK:
            np.testing.assert_allclose(placed.forward(commands).transforms, transform, rtol=0.0, atol=1e-10)
            found += 1
    assert found > 160  # stretched poses are not always found


@pytest.mark.parametrize("name", ["pm3dof", "hexapod"])
def test_random_round_trips_and_limits(name: str, library: Callable[..., Library]) -> None:
    compiled = library(name)
    robot = compiled.robot
    lower, upper = np.array([robot.range_of(c) for c in robot.coordinates]).T
    within = reachable_poses(robot, 500, np.random.default_rng(1))
    beyond = robot.solve(within.coordinates + 0.2 * (upper - lower), on_failure="nan")
    assert (beyond.broken_limits > 1).any()
    for poses in (within, beyond[beyond.solved]):
        for values, broken in zip(poses.coordinates, poses.broken_limits, strict=True):
            status, commands = compiled.inverse(values)
            assert status == OK
            assert compiled.limits() == broken >> 1
            status, back = compiled.forward(commands)
            assert status == OK
            assert np.abs(back - values).max() < 1e-9


def test_robot_without_coordinates_is_placed_by_its_tool(tmp_path: Path) -> None:
    """Every pose that forward reaches is on the branch on which inverse answers with the same commands."""
    bare = pm.load(MACHINES / "five_bar").replace(coordinates=())
    assert bare.coordinates == bare.command_coordinates
    placed = placed_by_tool(bare)
    assert [c.tool for c in placed.coordinates] == ["x", "y"]
    assert placed_by_tool(placed) is placed
    compiled = Library(Controller(placed), tmp_path)
    results = []
    for commands in np.random.default_rng(3).uniform(-1.2, 1.2, (300, 2)):
        status, pose = compiled.forward(commands)
        results.append(status)
        if status == OK:
            compiled.functions["start"](ctypes.byref(compiled.model), ctypes.byref(compiled.state))
            status, back = compiled.inverse(pose)
            if status != OPEN:  # a straight line from home to the pose leaves the workspace
                assert status == OK
                assert np.abs(back - commands).max() < 1e-9
    assert results.count(OK) > 100
    assert results.count(BEYOND) > 10


@pytest.mark.parametrize(("name", "reached"), [("delta", 600), ("linear_delta", 150)])
def test_legs_that_flip_in_pairs_are_noticed(library: Callable[..., Library], name: str, reached: int) -> None:
    """Signs of determinants stay when two legs flip; of a delta's poses at random commands 2 % were such."""
    compiled = library(name)
    robot = compiled.robot
    lower, upper = np.array([robot.range_of(command) for command in robot.command_coordinates]).T
    if name == "delta":
        lower, upper = np.maximum(lower, -3.0), np.minimum(upper, 3.0)
    spread = np.random.default_rng(1).uniform(-1.0, 1.0, (1000, len(lower))) * (upper - lower)
    found = 0
    for commands in 0.5 * (lower + upper) + spread:
        compiled.functions["start"](ctypes.byref(compiled.model), ctypes.byref(compiled.state))
        status, pose = compiled.forward(commands)
        if status != OK:
            continue
        compiled.functions["start"](ctypes.byref(compiled.model), ctypes.byref(compiled.state))
        status, back = compiled.inverse(pose)
        if status == OK:  # else a straight line from home leaves the workspace
            turns = 2.0 * np.pi if robot.command_coordinates[0].unit == "rad" else np.inf
            apart = back - commands
            apart -= turns * np.round(apart / turns) if np.isfinite(turns) else 0.0
            assert np.abs(apart).max() < 1e-9
            found += 1
    assert found > reached


def test_jacobian_is_the_derivative_of_inverse(library: Callable[..., Library]) -> None:
    compiled = library("hexapod")
    place, step = np.array([0.004, -0.003, 0.14, 0.03, -0.02, 0.05]), 1e-6
    columns = []
    for k in range(6):
        ends = [compiled.inverse(place + sign * step * np.eye(6)[k])[1] for sign in (1.0, -1.0)]
        columns.append((ends[0] - ends[1]) / (2.0 * step))
    assert compiled.inverse(place)[0] == OK
    assert np.allclose(compiled.jacobian()[1], np.array(columns).T, rtol=0.0, atol=1e-8)


def test_failures_leave_the_outputs_and_say_why(library: Callable[..., Library]) -> None:
    compiled = library("pm3dof")
    here = compiled.inverse([0.1, 0.1, 0.5])[1]
    for values, expected in (
        ([0.1, np.nan, 0.5], {NO_NUMBER}),
        ([0.1, 0.1, np.inf], {NO_NUMBER}),
        ([0.1, 0.1, 2.0], {BEYOND, OPEN}),
        ([1e9, 0.0, 0.5], {NO_NUMBER}),
    ):
        before = bytes(compiled.state)[: 8 * (compiled.state._fields_[0][1]._length_ + 3)]
        status, commands = compiled.inverse(values)
        assert status in expected
        assert (commands == 77.0).all()
        assert bytes(compiled.state)[: len(before)] == before
    assert np.allclose(compiled.inverse([0.1, 0.1, 0.5])[1], here, rtol=0.0, atol=1e-15)


def test_first_call_of_a_state_that_is_all_zeros_starts_from_home(library: Callable[..., Library]) -> None:
    compiled = library("hexapod")
    assert compiled.forward(np.zeros(6))[0] == OK  # the commands at home are zero
    assert compiled.state.walks == 1
    assert compiled.forward(np.full(6, 1e-5))[0] == OK
    assert compiled.state.walks == 0
    assert compiled.state.steps <= 2


@pytest.mark.parametrize("way", ["inverse", "forward"])
def test_smooth_motion_takes_one_step_and_its_end_costs_no_digits(way: str, library: Callable[..., Library]) -> None:
    """Where a parabola through three poses leads, one Newton step is enough; a stop and a turn back are met as well."""
    compiled, robot = library("hexapod"), pm.load("hexapod")
    angle = np.append(np.arange(0.0, 0.1, 0.01), [0.09, 0.03])  # goes round, stops, turns back
    places = robot.home_coordinates + 0.01 * np.outer(1.0 - np.cos(angle), np.eye(6)[0])
    places += 0.01 * np.outer(np.sin(angle), np.eye(6)[1])
    poses = robot.solve(places)
    given, wanted = (places, poses.commands) if way == "inverse" else (poses.commands, places)
    steps = []
    for each, answer in zip(given, wanted, strict=True):
        status, found = getattr(compiled, way)(each)
        assert status == OK
        np.testing.assert_allclose(found, answer, rtol=0.0, atol=1e-12)
        steps.append(compiled.state.steps)
    assert set(steps[4:10]) == {1}
    assert max(steps[10:]) <= 4


def test_contradicting_commands_of_redundant_drives(library: Callable[..., Library]) -> None:
    compiled = library("four_rrr")
    commands = np.array(compiled.robot.home.commands)
    assert compiled.forward(commands)[0] == OK
    commands[1] += 1e-4  # drives 0, 2 and 3 place the platform
    assert compiled.forward(commands)[0] == CONTRADICTION


def test_drive_that_turns_without_end_continues(library: Callable[..., Library]) -> None:
    compiled = library("four_bar")
    angles = np.linspace(0.0, 4.0 * np.pi, 200)
    commands = [compiled.inverse([angle])[1][0] for angle in angles + compiled.robot.home_coordinates[0]]
    assert np.allclose(np.diff(commands), angles[1], rtol=0.0, atol=1e-9)


def test_single_precision_is_as_good_as_said(library: Callable[..., Library]) -> None:
    compiled = library("pm3dof", real="float")
    header = c_files(controller("pm3dof"), real="float")["pm3dof.h"]
    stated = float(re.search(r"errors up to (\S+) m or rad", header).group(1))  # type: ignore[union-attr]
    failed, worst = compiled.selftest()
    assert failed == 0
    assert worst < 3.0 * stated < 1e-5


def test_calibrated_numbers_and_learned_table(tmp_path: Path) -> None:
    errors = pm.GeometricErrors.load("pm3dof")
    calibrated = errors.apply(errors.sample(np.random.default_rng(2)))

    def deviations(commands: np.ndarray) -> np.ndarray:
        return 1e-4 * np.sin(8.0 * commands[:, [1, 2, 0]])

    described = Controller(errors.robot, calibrated=calibrated, deviations=deviations)
    stated = described.models["calibrated"].correction.error  # type: ignore[union-attr]
    assert stated < 3e-6  # of linear interpolation: 1e-4 (8 x 0.0106)^2 / 8 = 1e-7, for each of one drive
    compiled = Library(described, tmp_path, "calibrated")
    assert compiled.selftest()[0] == 0
    for values in ([0.1, -0.1, 0.5], [0.0, 0.0, 0.493]):
        geometric = calibrated.solve(values, engine="pinocchio").commands
        wanted = np.array(geometric)
        for _ in range(20):
            wanted = geometric - deviations(wanted[None])[0]
        status, commands = compiled.inverse(values)
        assert status == OK
        assert np.abs(commands - wanted).max() < 1.1 * stated
        assert np.abs(geometric - errors.robot.solve(values).commands).max() > 1e-5
        assert np.abs(compiled.forward(commands)[1] - values).max() < 1e-9
    plain = Library(described, tmp_path, "nominal")
    assert np.allclose(plain.inverse([0.1, 0.0, 0.5])[1], errors.robot.solve([0.1, 0.0, 0.5]).commands, atol=1e-12)


def test_table_of_six_drives_is_refused() -> None:
    with pytest.raises(InvalidValueError, match=r"has 6 drives.*at most 3"):
        Controller(pm.load("hexapod"), deviations=lambda commands: 0.0 * commands)


def test_header_alone_has_the_functions(tmp_path: Path) -> None:
    compiler = shutil.which("gcc")
    if compiler is None:
        pytest.skip("no C compiler")
    files = export_controller(pm.load("pm3dof"), "c", tmp_path, header_only=True)
    assert [file.name for file in files] == ["pm3dof.h", "pm3dof_parameters.h"]
    main = '#include "pm3dof.h"\nint main(void) { double worst; return pm3dof_selftest(&pm3dof_nominal, &worst); }\n'
    (tmp_path / "main.c").write_text(main)
    subprocess.run([compiler, *STRICT, "-O1", "main.c", "-o", "main", "-lm"], cwd=tmp_path, check=True)
    assert subprocess.run([tmp_path / "main"], check=False).returncode == 0


@pytest.mark.parametrize(
    "command", [("arm-none-eabi-gcc", "-mcpu=cortex-m7", "-mthumb"), ("avr-gcc", "-mmcu=atmega2560"), ("g++",)]
)
def test_other_compilers(command: tuple[str, ...], tmp_path: Path) -> None:
    if shutil.which(command[0]) is None:
        pytest.skip(f"no {command[0]}")
    library = subprocess.run([*command, "-E", "-"], input=b"#include <math.h>\n", capture_output=True, check=False)
    if library.returncode:
        pytest.skip(f"{command[0]} has no C library")
    export_controller(pm.load("pm3dof"), "c", tmp_path, real="float")
    if command[0] == "g++":
        (tmp_path / "pm3dof.c").write_text('#include "pm3dof.h"\nint main() { return PM3DOF_COMMANDS - 3; }\n')
        strict: tuple[str, ...] = ("-Wall", "-Wextra", "-Werror")
    else:
        strict = STRICT
    subprocess.run([*command, *strict, "-Os", "-c", "pm3dof.c"], cwd=tmp_path, check=True)


def test_web_assembly(tmp_path: Path) -> None:
    pytest.importorskip("ziglang")
    node = shutil.which("node")
    if node is None:
        pytest.skip("no Node")
    export_controller(pm.load("pm3dof"), "c", tmp_path)
    (tmp_path / "main.c").write_text(
        '#include "pm3dof.h"\ndouble worst(void) { double w; return pm3dof_selftest(&pm3dof_nominal, &w) ? 1.0 : w; }\n'
    )
    build = [sys.executable, "-m", "ziglang", "cc", "-target", "wasm32-wasi", "-O2", "-mexec-model=reactor"]
    build += ["-Wl,--export=worst", "pm3dof.c", "main.c", "-o", "pm3dof.wasm"]
    subprocess.run(build, cwd=tmp_path, check=True, capture_output=True)
    script = """
const module = new WebAssembly.Module(require("fs").readFileSync("pm3dof.wasm"));
const none = new Proxy({}, { get: () => () => 0 });
const names = Object.fromEntries(WebAssembly.Module.imports(module).map((each) => [each.module, none]));
console.log(new WebAssembly.Instance(module, names).exports.worst());
"""
    answer = subprocess.run([node, "-e", script], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert 0.0 < float(answer.stdout) < 1e-12
