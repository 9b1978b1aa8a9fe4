"""LinuxCNC configurations: run headless in LinuxCNC itself, and compared with its own kinematics modules."""

from __future__ import annotations

import csv
import ctypes
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import pm3dof_pin as pm
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS, tool_coordinates
from pm3dof_pin.export.axis_limits import axis_limits
from pm3dof_pin.export.controllers import export_controller
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.paths.controller import controller_limits
from pm3dof_pin.paths.evaluation import PathOptions, evaluate_path
from pm3dof_pin.paths.follower import with_tool_length
from pm3dof_pin.paths.tool_path import read_path

MODULES = Path("/usr/lib/linuxcnc/modules")


def _can_run() -> bool:
    if shutil.which("linuxcnc") is None or shutil.which("halcompile") is None:
        return False
    probe = ["unshare", "-r", "-m", "-i", "-n", "-p", "--fork", "--mount-proc", "unshare", "-U", "--map-user=1000"]
    return subprocess.run([*probe, "true"], capture_output=True, check=False).returncode == 0


needs_linuxcnc = pytest.mark.skipif(not _can_run(), reason="no LinuxCNC, or no user namespaces")


def run(folder: Path, program: str | None = None) -> subprocess.CompletedProcess[str]:
    """Run the exported check, or another program in its place."""
    if program is not None:
        (folder / "check.ngc").write_text(program)
    environment = {"PATH": "/usr/bin:/bin:/usr/sbin:/sbin", "LANG": "C.UTF-8", "USER": "user"}
    command = ["sh", folder / "run_sim.sh"]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, env=environment, check=False)


@pytest.fixture(scope="module", params=["pm3dof", "hexapod", "linear_delta"])
def configuration(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp(request.param)
    export_controller(pm.load(request.param), "linuxcnc", folder)
    return folder


@pytest.fixture
def tripod(tmp_path: Path) -> Path:
    export_controller(pm.load("pm3dof"), "linuxcnc", tmp_path)
    return tmp_path


@needs_linuxcnc
def test_joints_at_the_stops(configuration: Path) -> None:
    done = run(configuration)
    assert done.returncode == 0, done.stdout + done.stderr
    worst = float(re.search(r"worst (\S+) mm or deg at 12 stops", done.stdout).group(1))  # type: ignore[union-attr]
    assert worst < 1e-9


def test_expected_joints_and_moves_between(configuration: Path) -> None:
    robot = pm.load(configuration.name[:-1])
    with (configuration / "check_joints.csv").open(newline="") as file:
        header, *rows = csv.reader(file)
    numbers = np.array(rows, dtype=float)
    axes = [k for k, name in enumerate(header) if name.startswith("stop ")]
    shown = np.array([1000.0 if c.unit == "m" else np.degrees(1.0) for c in robot.coordinates])
    poses = robot.solve(numbers[:, axes] / shown, engine="pinocchio")
    assert np.allclose(numbers[:, len(axes) :], 1000.0 * poses.commands, rtol=0.0, atol=1e-9)
    assert poses.within_limits.all()


@needs_linuxcnc
def test_a_wrong_parameter_is_noticed(tripod: Path) -> None:
    """The self-test refuses to load a module whose geometry is 10 um off; without it, the joints are off by that."""
    parameters = tripod / "pm3dof_parameters.h"
    text = parameters.read_text()
    row = next(line for line in text.splitlines() if re.search(r"/\* .*/p[012] \*/", line))
    value = float(row.split(",")[0].strip(" ()"))
    parameters.write_text(text.replace(row, row.replace(row.split(",")[0], f"  {value + 1e-5!r}", 1)))
    done = run(tripod)
    assert done.returncode != 0
    assert "poses of the self-test are wrong" in done.stdout + done.stderr
    module = tripod / "pm3dof_kins.c"
    module.write_text(module.read_text().replace("if (failed)", "if (failed < 0)"))
    done = run(tripod)
    assert done.returncode != 0
    off = float(re.search(r"joints are off by (\S+) mm", done.stdout + done.stderr).group(1))  # type: ignore[union-attr]
    assert 1e-3 < off < 0.1


@needs_linuxcnc
def test_a_program_that_leaves_the_workspace_stops(tripod: Path) -> None:
    done = run(tripod, "G21 G90\nG0 A0 B0 Z500\nM0\nG0 A39 B39 Z577\nM0\nM2\n")
    assert done.returncode != 0
    assert "limit" in done.stdout + done.stderr


@needs_linuxcnc
@pytest.mark.parametrize("calibrated", [True, False])
def test_tilted_tool_of_the_calibrated_and_of_the_described_robot(calibrated: bool, tmp_path: Path) -> None:
    """The pin switches between two sets of numbers, and the tip stays where the program wants it."""
    errors = pm.GeometricErrors.load("hexapod")
    identified = errors.apply(errors.sample(np.random.default_rng(2)))
    export_controller(errors.robot, "linuxcnc", tmp_path, calibrated=identified)
    hal = tmp_path / "hexapod.hal"
    assert "setp hexapod_kins.calibrated 1" in hal.read_text()
    hal.write_text(hal.read_text().replace("calibrated 1", f"calibrated {int(calibrated)}"))
    (tmp_path / "tool.tbl").write_text("T1 P1 Z30\n")
    stops = np.array([[2.0, -3.0, 105.0, 3.0, -2.0, 1.0], [-4.0, 1.0, 108.0, -5.0, 4.0, -2.0]])
    pointed = with_tool_length(identified if calibrated else errors.robot, -0.03)
    angles = np.where(np.arange(6) < 3, 1e-3, np.radians(1.0))
    commands = pointed.replace(coordinates=tool_coordinates(TOOL_COMPONENTS)).solve(stops * angles).commands
    rows = [",".join([f"stop {c}" for c in "XYZABC"] + [f"joint_{k}" for k in range(6)])]
    rows += [
        ",".join(map(repr, [*stop, *joints]))
        for stop, joints in zip(stops.tolist(), (1e3 * commands).tolist(), strict=True)
    ]
    (tmp_path / "check_joints.csv").write_text("\n".join(rows) + "\n")
    words = ["".join(f"{c}{v} " for c, v in zip("XYZABC", stop, strict=True)) for stop in stops.tolist()]
    done = run(tmp_path, "\n".join(["G21 G90 G61", "T1 M6 G43", *(f"G0 {w}\nG4 P0.1\nM0" for w in words), "M2\n"]))
    assert done.returncode == 0, done.stdout + done.stderr


@needs_linuxcnc
def test_part_is_cut_where_it_was_judged_to_be(tmp_path: Path) -> None:
    """The joints of LinuxCNC along a program, and how long it takes."""
    robot, zero = pm.load("hexapod"), np.eye(4)
    zero[2, 3] = 0.134
    export_controller(robot, "linuxcnc", tmp_path)
    text = "G21 G90 G54 G64 P0.01\nG0 X0 Y0 Z2\nG1 Z0 F200\nG1 X4 F600\nG3 X4 I-4\nG1 X0\nG0 Z2\nM2\n"
    (tmp_path / "part.ngc").write_text(text)
    (tmp_path / "placed.ngc").write_text("G21\nG10 L2 P1 X0 Y0 Z134\n" + text)
    environment = {"PATH": "/usr/bin:/bin:/usr/sbin:/sbin", "LANG": "C.UTF-8", "USER": "user"}
    command = ["sh", tmp_path / "run_sim.sh", tmp_path / "placed.ngc"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, env=environment, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    _, *joints = np.loadtxt(tmp_path / "joints.csv", delimiter=",", skiprows=1).T
    path = read_path(robot, tmp_path / "part.ngc", workpiece={54: zero})
    limits = controller_limits(robot, tmp_path / "hexapod.ini")
    found = evaluate_path(robot, path, PathOptions(limits=limits, spacing=1e-5))
    wanted = np.stack([found.columns[f"tool_{axis}_m"] for axis in "xyz"], axis=1)
    tool = robot.forward(1e-3 * np.transpose(joints)).positions
    tool = tool[np.flatnonzero(np.abs(tool[:, 2] - 0.136) < 1e-6)[0] :]  # from the first stop of the program on
    off = cKDTree(wanted).query(tool)[0]
    assert off.max() < 1.2e-5  # G64 P0.01, and half the distance of the points
    assert np.linalg.norm(tool[-1] - wanted[-1]) < 1e-9


PROTOTYPES = """
#include "kinematics.h"
#include "emcmotcfg.h"
#include "posemath.h"
extern int kinematicsJacobian(const double *joint, const EmcPose *world,
                              double jac[EMCMOT_MAX_JOINTS][EMCMOT_MAX_AXIS], const KINEMATICS_INVERSE_FLAGS *iflags);
extern int kinematicsToolFrame(const double *joint, PmRotationMatrix *rot, const KINEMATICS_FORWARD_FLAGS *fflags);
#include "MODULE.c"
int sizes(int k) { return k ? EMCMOT_MAX_AXIS : EMCMOT_MAX_JOINTS; }
"""
"""As LinuxCNC's developers declare them after 2.9."""


@pytest.mark.skipif(not Path("/usr/include/linuxcnc/kinematics.h").is_file(), reason="no headers of LinuxCNC")
@pytest.mark.parametrize("name", ["hexapod", "pm3dof", "linear_delta"])
@pytest.mark.parametrize("tool", [0.0, 25.0])
def test_jacobian_and_tool_frame_of_newer_versions(name: str, tool: float, tmp_path: Path) -> None:
    robot = pm.load(name)
    export_controller(robot, "linuxcnc", tmp_path)
    (tmp_path / "newer.c").write_text(PROTOTYPES.replace("MODULE", f"{name}_kins"))
    defines = ["RTAPI", "USPACE", "_GNU_SOURCE", "__MODULE__", "PM3DOF_LINUXCNC_HAS_JACOBIAN"]
    build = ["gcc", "-shared", "-fPIC", "-Wall", "-I/usr/include/linuxcnc", *(f"-D{word}" for word in defines)]
    build += ["newer.c", "-o", f"{name}.so", "-lm"]
    subprocess.run(build, cwd=tmp_path, check=True)
    library = stubs()
    module = ctypes.CDLL(str(tmp_path / f"{name}.so"))
    assert module.rtapi_app_main() == 0
    assert library.set_pin(f"{name}_kins.tool-offset".encode(), tool)
    joints, axes = module.sizes(0), module.sizes(1)
    flags_of = (ctypes.c_ulong * 2)()

    def inverse(world: np.ndarray) -> np.ndarray:
        answer = (ctypes.c_double * joints)()
        assert module.kinematicsInverse((ctypes.c_double * 9)(*world), answer, flags_of, flags_of) == 0
        return np.array(answer[: len(robot.commands)])

    places = {"hexapod": range(6), "pm3dof": (2, 3, 4), "linear_delta": range(3)}[name]
    world = np.zeros(9)
    world[:3] = 1e3 * robot.home.tool_placement.translation
    world[list(places)] += np.linspace(1.0, 2.0, len(places))
    world[2] -= tool
    at = inverse(world)
    jacobian = np.full((joints, axes), np.nan)
    place = (ctypes.c_double * 9)(*world)
    assert (
        module.kinematicsJacobian(
            (ctypes.c_double * joints)(*at), place, jacobian.ctypes.data_as(ctypes.c_void_p), flags_of
        )
        == 0
    )
    expected = np.zeros((joints, axes))
    for k in places:
        ends = [inverse(world + sign * 1e-3 * np.eye(9)[k]) for sign in (1.0, -1.0)]
        expected[: len(at), k] = (ends[0] - ends[1]) / 2e-3
    np.testing.assert_allclose(jacobian, expected, atol=1e-7)
    frame = (ctypes.c_double * 9)()
    assert module.kinematicsToolFrame((ctypes.c_double * joints)(*at), frame, flags_of) == 0
    scale = np.array([1e-3 if command.unit == "m" else np.radians(1.0) for command in robot.commands])
    turned = robot.forward(at * scale).rotations @ robot.home.tool_placement.rotation.T
    np.testing.assert_allclose(np.array(frame).reshape(3, 3).T, turned, atol=1e-9)  # PmRotationMatrix has columns


def test_axis_limits_keep_every_drive_within_its_own() -> None:
    """Differences of commands along random straight motions at the limits, with other poses than the export's."""
    robot = pm.load("hexapod")
    limits = axis_limits(robot)
    generator = np.random.default_rng(8)
    poses = reachable_poses(robot, 300, generator, margin=0.02)
    directions = generator.choice([-1.0, 1.0], (300, 6))
    step = 1e-4  # s
    along = [robot.solve(poses.coordinates + t * step * directions * limits.speed).commands for t in (-1, 0, 1)]
    rates = (along[2] - along[0]) / (2.0 * step)
    assert (np.abs(rates) < 1.02 * limits.drive_speed).all()
    assert np.abs(rates / limits.drive_speed).max() > 0.5
    bent = np.abs(along[2] - 2.0 * along[1] + along[0]) / step**2
    by_acceleration = np.abs(pm.jacobian(robot, poses, of="commands", by="coordinates").values) @ limits.acceleration
    assert (bent + by_acceleration < 1.02 * limits.drive_acceleration + 1e-6).all()


STUBS = r"""
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
static char names[400][64];
static double values[400];
static int count;
static int keep(void **pin, const char *format, va_list arguments)
{
  vsnprintf(names[count], 64, format, arguments);
  *pin = &values[count++];
  return 0;
}
#define PIN(kind) \
  int hal_pin_##kind##_newf(int way, void **pin, int component, const char *format, ...) \
  { va_list a; (void)way; (void)component; va_start(a, format); keep(pin, format, a); va_end(a); return 0; } \
  int hal_pin_##kind##_new(const char *name, int way, void **pin, int component) \
  { (void)way; (void)component; strncpy(names[count], name, 63); *pin = &values[count++]; return 0; }
PIN(float) PIN(bit) PIN(s32) PIN(u32)
int hal_init(const char *name) { (void)name; return 1; }
int hal_exit(int component) { return component; }
int hal_ready(int component) { (void)component; return 0; }
void *hal_malloc(long size) { return calloc(1, (size_t)size); }
void rtapi_print(const char *format, ...) { (void)format; }
void rtapi_print_msg(int level, const char *format, ...) { (void)level; (void)format; }
int set_pin(const char *name, double value)
{
  int k, found = 0;
  for (k = 0; k < count; k++)
    if (!strcmp(names[k], name)) { values[k] = value; found = 1; }
  return found;
}
"""


@cache
def stubs() -> ctypes.CDLL:
    """Return functions that stand in for HAL, for all modules that are loaded after it."""
    folder = Path(tempfile.mkdtemp())
    (folder / "stubs.c").write_text(STUBS)
    subprocess.run(["gcc", "-shared", "-fPIC", "stubs.c", "-o", "stubs.so"], cwd=folder, check=True)
    library = ctypes.CDLL(str(folder / "stubs.so"), mode=os.RTLD_GLOBAL)
    library.set_pin.argtypes = [ctypes.c_char_p, ctypes.c_double]
    return library


def pins_of(file: Path) -> Mapping[str, float]:
    found = re.findall(r"^setp (\S+) (\S+)$", file.read_text(), re.MULTILINE)
    return {name: float(value) for name, value in found}


@pytest.mark.skipif(not (MODULES / "genhexkins.so").is_file() or shutil.which("gcc") is None, reason="no LinuxCNC")
def test_hexapod_as_genhexkins(tmp_path: Path) -> None:
    robot = pm.load("hexapod")
    export_controller(robot, "linuxcnc", tmp_path)
    library = stubs()
    module = ctypes.CDLL(str(MODULES / "genhexkins.so"))
    assert module.rtapi_app_main() == 0
    pins = pins_of(tmp_path / "genhexkins.hal")
    assert len(pins) == 36
    assert all(library.set_pin(name.encode(), value) for name, value in pins.items())
    lengths = re.search(r"plus (.*)", (tmp_path / "genhexkins.hal").read_text()).group(1)  # type: ignore[union-attr]
    poses = reachable_poses(robot, 200, np.random.default_rng(4))
    numbers = (ctypes.c_double * 16)()
    flags = (ctypes.c_ulong * 2)()
    for commands, place, matrix in zip(poses.commands, poses.positions, poses.rotations, strict=True):
        c, b, a = Rotation.from_matrix(matrix).as_euler("ZYX", degrees=True)
        world = (ctypes.c_double * 9)(*(1000.0 * place), a, b, c, 0.0, 0.0, 0.0)
        assert module.kinematicsInverse(world, numbers, flags, flags) == 0
        expected = 1000.0 * commands + np.array(lengths.split(", "), dtype=float)
        assert np.abs(np.array(numbers[:6]) - expected).max() < 2e-9  # offsets are printed to 1e-9 mm


def test_delta_as_lineardeltakins() -> None:
    """Effective radius 130 mm, rods of 270 mm, tool 40 mm below the rods.

    Its towers are at 90, 210 and 330 degrees, counter-clockwise whatever its manual says; ours at 210, 330 and 90.
    """
    python = Path("/usr/bin/python3")
    robot = pm.load("linear_delta")
    poses = reachable_poses(robot, 200, np.random.default_rng(4))
    code = "import sys, lineardeltakins as k\nk.set_geometry(130.0, 270.0)\nfor line in sys.stdin:\n"
    code += "    print(*map(repr, k.inverse(*map(float, line.split()))[:3]))\n"
    lines = "\n".join(" ".join(map(repr, row)) for row in (1000.0 * poses.coordinates).tolist())
    done = subprocess.run([python, "-c", code], input=lines, capture_output=True, text=True, check=False, env={})
    if "No module named" in done.stderr or not python.is_file():
        pytest.skip("no lineardeltakins")
    found = np.array([line.split() for line in done.stdout.splitlines()], dtype=float)[:, [1, 2, 0]]
    assert np.abs(found + 40.0 - 1000.0 * poses.commands).max() < 1e-9
