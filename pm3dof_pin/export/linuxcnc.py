"""A LinuxCNC configuration: kinematics module, HAL and INI files, a program of checks and a headless run of it."""

from __future__ import annotations

import itertools
import math
import re
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pm3dof_pin.description.coordinates import TOOL_COMPONENTS, Coordinate
from pm3dof_pin.exceptions import InvalidValueError, SingularConfigurationError, UnreachablePoseError
from pm3dof_pin.export.axis_limits import AxisLimits, axis_limits
from pm3dof_pin.export.c_kinematics import c_files
from pm3dof_pin.export.controller import Controller
from pm3dof_pin.files import csv_text
from pm3dof_pin.kinematics.coordinate_ranges import coordinate_ranges
from pm3dof_pin.kinematics.jacobians import jacobian
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Matrix, Vector

_LETTERS = {"x": "X", "y": "Y", "z": "Z", "rx": "A", "ry": "B", "rz": "C"}
_SPARE = {"m": "XYZUVW", "rad": "ABC"}
_MEMBERS = {letter: f"tran.{letter.lower()}" if letter in "XYZ" else letter.lower() for letter in "XYZABCUVW"}
_INDICES = {letter: index for index, letter in enumerate("XYZABCUVW")}
_SHOWN = {"m": 1000.0, "rad": 180.0 / math.pi}  # mm, degrees
_PARALLEL = 1e-6  # greatest deviation of an axis from a component of the tool's motion
_STOPS, _TRIALS, _SEED = 12, 400, 1
_NEARER = 0.7  # of the way from home to a random pose, for stops between which straight moves stay within limits
_BETWEEN = 20  # poses of a move that are compared with the limits
_DIGITS = 6  # of millimetres and degrees in the program
_SAME = 1e-9  # greatest difference of a hexapod's struts from those of genhexkins [m]
_TOLERANCE = 1e-9  # of the joints at the stops [mm, deg]


@dataclass(frozen=True, eq=False)
class _Axes:
    """Axis letters of the coordinates, and which component of the tool's position each is."""

    letters: tuple[str, ...]
    positions: tuple[int | None, ...]  #: 0, 1, 2 for x, y, z of the tool; None for others

    @classmethod
    def of(cls, robot: Robot) -> _Axes:
        """Match coordinates with axes: those of the tool's motion at home, or else the first that are left.

        Raises:
            InvalidValueError: LinuxCNC has no axis left for a coordinate.
        """
        components = [_component(robot, k) for k in range(len(robot.coordinates))]
        taken = [_LETTERS[name] for name in components if name is not None]
        letters = []
        for coordinate, component in zip(robot.coordinates, components, strict=True):
            if component is not None:
                letters.append(_LETTERS[component])
                continue
            left = [letter for letter in _SPARE[coordinate.unit] if letter not in (*taken, *letters)]
            if not left:
                raise InvalidValueError(f"{robot.name} has no axis for {coordinate.name}", expected="at most nine axes")
            letters.append(left[0])
        if len(set(letters)) < len(letters):
            raise InvalidValueError("axes of " + robot.name, " ".join(letters), "a different one for each coordinate")
        places = [None if c is None or c.startswith("r") else "xyz".index(c) for c in components]
        return cls(tuple(letters), tuple(places))


def _component(robot: Robot, index: int) -> str | None:
    """Return the component of the tool's placement that a coordinate is, or None."""
    coordinate = robot.coordinates[index]
    if coordinate.tool is not None:
        return coordinate.tool
    if robot.tool_frame is None:
        return None
    with suppress(SingularConfigurationError):
        twists = jacobian(robot, robot.home, of="tool", by="coordinates").values
        for k, name in enumerate(TOOL_COMPONENTS):
            unit = (k < 3) == (coordinate.unit == "m")
            across = np.delete(twists[:3] if k < 3 else twists[3:], k % 3, axis=0)[:, index]
            if unit and abs(twists[k, index] - 1.0) < _PARALLEL and np.abs(across).max() < _PARALLEL:
                return name
    return None


class _Machine:
    """A robot as LinuxCNC sees it: axes, and joints in millimetres and degrees."""

    def __init__(self, controller: Controller) -> None:
        self.controller, self.robot = controller, controller.robot
        self.name, self.module = controller.name, f"{controller.name}_kins"
        self.axes = _Axes.of(self.robot)
        self.shown = np.array([_SHOWN[c.unit] for c in self.robot.coordinates])
        self.joint_shown = np.array([_SHOWN[c.unit] for c in self.robot.commands])

    @cached_property
    def limits(self) -> AxisLimits:
        return axis_limits(self.robot)

    @cached_property
    def stops(self) -> tuple[Matrix, Matrix]:
        """Poses that straight moves reach one after the other [mm, deg], and the joints there, by Pinocchio."""
        robot = self.robot
        home = robot.home_coordinates
        drawn = reachable_poses(robot, _TRIALS, np.random.default_rng(_SEED)).coordinates
        wanted = np.round((home + _NEARER * (drawn - home)) * self.shown, _DIGITS)
        lower, upper = coordinate_ranges(robot, robot.coordinates)
        wanted = wanted[((wanted >= lower * self.shown) & (wanted <= upper * self.shown)).all(axis=1)]
        stops, last = [], home
        for values in wanted:
            here = values / self.shown
            between = last + np.linspace(0.0, 1.0, _BETWEEN)[:, None] * (here - last)
            if robot.solve(between, on_failure="nan").within_limits.all():
                stops.append(values)
                last = here
            if len(stops) == _STOPS:
                break
        if len(stops) < _STOPS:
            raise UnreachablePoseError(f"{robot.name}: straight moves reach only {len(stops)} of {_STOPS} random poses")
        poses = robot.solve(np.array(stops) / self.shown, engine="pinocchio")
        return np.array(stops), poses.commands * self.joint_shown


def linuxcnc_files(controller: Controller) -> dict[str, str]:
    """Return the files of a configuration: texts by path."""
    machine = _Machine(controller)
    name = machine.name
    stops, joints = machine.stops
    head = [f"stop {letter}" for letter in machine.axes.letters]
    head += [f"joint_{k}" for k in range(joints.shape[1])]
    rows = [
        [*map(repr, stop), *map(repr, values)] for stop, values in zip(stops.tolist(), joints.tolist(), strict=True)
    ]
    hexapod = _genhexkins(machine.robot)
    return {
        **c_files(controller, header_only=True),
        f"{machine.module}.c": _module(machine),
        f"{name}.hal": _hal(machine),
        f"{name}.ini": _ini(machine),
        **({} if hexapod is None else {"genhexkins.hal": hexapod}),
        "check.ngc": _program(machine, stops),
        "check_joints.csv": csv_text([head, *rows]),
        "check.py": _CHECK.replace("@TOLERANCE@", repr(_TOLERANCE)),
        "run_sim.sh": _RUN.replace("@MODULE@", machine.module).replace("@NAME@", name),
        "tool.tbl": "T1 P1 Z0 ;no tool\n",
        "README.md": _readme(machine),
    }


_MODULE = """/*
 * LinuxCNC kinematics module of @ROBOT@, for LinuxCNC 2.9; millimetres and degrees.
 *
 * SPDX-License-Identifier: GPL-2.0-only
 * This file is under the GNU General Public License, version 2, because it includes headers of LinuxCNC that are.
 * @NAME@.h and @NAME@_parameters.h, which it includes, are not derived from LinuxCNC and stay under their own licence.
 *
 * Build: halcompile --compile @MODULE@.c, and as root: halcompile --install @MODULE@.c
 * For a LinuxCNC with kinematicsJacobian and kinematicsToolFrame define PM3DOF_LINUXCNC_HAS_JACOBIAN.
 */
#include "rtapi.h"
#include "rtapi_app.h"
#include "rtapi_math.h"
#include "hal.h"
#include "kinematics.h"
#ifdef PM3DOF_LINUXCNC_HAS_JACOBIAN
#include "emcmotcfg.h"
#include "posemath.h"
#endif

#include "@NAME@.h"

MODULE_LICENSE("GPL");

#define JOINTS @UPPER@_COMMANDS
#define AXES @UPPER@_COORDINATES

static struct {
  hal_s32_t *iterations;    /* Newton steps of the last call, 100 for each walk */
  hal_u32_t *failures;      /* calls without an answer */
  hal_float_t *tool_offset; /* length of the tool along z at home [mm]: motion.tooloffset.z */
  hal_bit_t *calibrated;    /* which numbers: as described, or calibrated */
} *pins;

static @NAME@_state inverse_state, forward_state;
static int is_placed;
static int component;

static const double joint_unit[JOINTS] = {@JOINT_UNITS@}; /* LinuxCNC's unit [m, rad] */
static const double axis_unit[AXES] = {@AXIS_UNITS@};

static const @NAME@_model *model(void)
{
  return @SWITCH@;
}

static void report(const @NAME@_state *state, int status)
{
  *pins->iterations = state->steps + 100 * state->walks;
  if (status != @UPPER@_OK)
    ++*pins->failures;
}

static void get(const EmcPose *world, double *x)
{
@GET@
}

static void put(const double *x, EmcPose *world)
{
@PUT@
}

/* The controlled point is the tip. LinuxCNC has added the tool's length along z: what tilting it changes. */
static void shift_by_tool(const @NAME@_state *state, double *shift)
{
  int k;
  for (k = 0; k < AXES; k++)
    shift[k] = 0.0;
@SHIFT@
}

EXPORT_SYMBOL(kinematicsType);
EXPORT_SYMBOL(kinematicsInverse);
EXPORT_SYMBOL(kinematicsForward);
#ifdef KINS_NOT_SWITCHABLE
KINS_NOT_SWITCHABLE
#endif

KINEMATICS_TYPE kinematicsType(void)
{
  return KINEMATICS_BOTH;
}

int kinematicsInverse(const EmcPose *world, double *joint, const KINEMATICS_INVERSE_FLAGS *iflags,
                      KINEMATICS_FORWARD_FLAGS *fflags)
{
  double x[AXES], target[AXES], shift[AXES], commands[JOINTS], change = 1.0;
  int k, round, status = @UPPER@_OK;
  (void)iflags;
  (void)fflags;
  get(world, x);
  if (!inverse_state.is_started)
    @NAME@_start(model(), &inverse_state);
  for (round = 0; round < 8 && change > 1e-13; round++) { /* the tilt follows from the pose: two rounds */
    shift_by_tool(&inverse_state, shift);
    for (k = 0, change = 0.0; k < AXES; k++) {
      if (round && fabs(x[k] + shift[k] - target[k]) > change)
        change = fabs(x[k] + shift[k] - target[k]);
      target[k] = x[k] + shift[k];
    }
    if (round && change <= 1e-13)
      break;
    status = @NAME@_inverse(model(), &inverse_state, target, commands);
    if (status != @UPPER@_OK)
      break;
    change = *pins->tool_offset == 0.0 ? 0.0 : 1.0;
  }
  report(&inverse_state, status);
  if (status != @UPPER@_OK)
    return -1;
  for (k = 0; k < JOINTS; k++)
    joint[k] = commands[k] / joint_unit[k];
  return 0;
}

int kinematicsForward(const double *joint, EmcPose *world, const KINEMATICS_FORWARD_FLAGS *fflags,
                      KINEMATICS_INVERSE_FLAGS *iflags)
{
  double commands[JOINTS], x[AXES], shift[AXES];
  int k, status;
  (void)fflags;
  (void)iflags;
  for (k = 0; k < JOINTS; k++)
    commands[k] = joint[k] * joint_unit[k];
  status = @NAME@_forward(model(), &forward_state, commands, x);
  report(&forward_state, status);
  if (status != @UPPER@_OK) {
    if (is_placed)
      return -1;
    @NAME@_start(model(), &forward_state); /* not homed: joints are anything; the pose at home stands for them */
@HOME@
  }
  is_placed |= status == @UPPER@_OK;
  shift_by_tool(&forward_state, shift);
  for (k = 0; k < AXES; k++)
    x[k] -= shift[k];
  put(x, world);
  return 0;
}

#ifdef PM3DOF_LINUXCNC_HAS_JACOBIAN
EXPORT_SYMBOL(kinematicsJacobian);
EXPORT_SYMBOL(kinematicsToolFrame);

/* Joint per pose unit, without tool length. */
int kinematicsJacobian(const double *joint, const EmcPose *pos, double jac[EMCMOT_MAX_JOINTS][EMCMOT_MAX_AXIS],
                       const KINEMATICS_INVERSE_FLAGS *iflags)
{
  static const int axis[AXES] = {@AXIS_INDICES@};
  double x[AXES], commands[JOINTS], found[JOINTS][AXES];
  @NAME@_state state = inverse_state;
  int j, k;
  (void)joint;
  (void)iflags;
  get(pos, x);
  if (*pins->tool_offset != 0.0 || @NAME@_inverse(model(), &state, x, commands) != @UPPER@_OK ||
      @NAME@_jacobian(model(), &state, found) != @UPPER@_OK)
    return -1;
  for (j = 0; j < JOINTS; j++) {
    for (k = 0; k < EMCMOT_MAX_AXIS; k++)
      jac[j][k] = 0.0;
    for (k = 0; k < AXES; k++)
      jac[j][axis[k]] = found[j][k] * axis_unit[k] / joint_unit[j];
  }
  return 0;
}

int kinematicsToolFrame(const double *joint, PmRotationMatrix *rot, const KINEMATICS_FORWARD_FLAGS *fflags)
{
@TOOL_FRAME@
}
#endif

int rtapi_app_main(void)
{
  double worst;
  const int failed = @NAME@_selftest(&@NAME@_nominal, &worst);
  if (failed) {
    rtapi_print_msg(RTAPI_MSG_ERR, "@MODULE@: %d poses of the self-test are wrong\\n", failed);
    return -1;
  }
  component = hal_init("@MODULE@");
  if (component < 0)
    return component;
  pins = hal_malloc(sizeof(*pins));
  if (!pins || hal_pin_s32_new("@MODULE@.iterations", HAL_OUT, &pins->iterations, component) < 0 ||
      hal_pin_u32_new("@MODULE@.failures", HAL_OUT, &pins->failures, component) < 0 ||
      hal_pin_float_new("@MODULE@.tool-offset", HAL_IN, &pins->tool_offset, component) < 0 ||
      hal_pin_bit_new("@MODULE@.calibrated", HAL_IN, &pins->calibrated, component) < 0) {
    hal_exit(component);
    return -1;
  }
  *pins->calibrated = @HAS_CALIBRATED@;
  hal_ready(component);
  return 0;
}

void rtapi_app_exit(void)
{
  hal_exit(component);
}
"""


def _module(machine: _Machine) -> str:
    robot, name, axes = machine.robot, machine.name, machine.axes
    pairs = list(zip(axes.letters, range(len(axes.letters)), strict=True))
    moved = [(k, place) for k, place in enumerate(axes.positions) if place is not None]
    has_tool, is_calibrated = robot.tool_frame is not None, "calibrated" in machine.controller.models
    shift, frame = ["  (void)state;"], ["  (void)joint;", "  (void)rot;", "  (void)fflags;", "  return -1;"]
    if has_tool:
        lines = [
            "double T[4][4], commands[JOINTS];",
            f"{name}_state state = forward_state;",
            "double x[AXES];",
            "int k;",
            "(void)fflags;",
            "for (k = 0; k < JOINTS; k++)",
            "  commands[k] = joint[k] * joint_unit[k];",
            f"if ({name}_forward(model(), &state, commands, x) != {name.upper()}_OK)",
            "  return -1;",
            f"{name}_tool(model(), &state, T);",
            *(f"rot->{'xyz'[j]}.{'xyz'[i]} = T[{i}][{j}];" for j in range(3) for i in range(3)),
            "return 0;",
        ]
        frame = [f"  {line}" for line in lines]
    if has_tool and moved:
        along = robot.home.tool_placement.rotation.T[:, 2]
        terms = ["{" + ", ".join(repr(float(value)) for value in along) + "}"]
        shift = [
            f"  if (*pins->tool_offset != 0.0) {{ /* z at home, in axes of the tool: {terms[0]} */",
            f"    static const double z[3] = {terms[0]};",
            "    double T[4][4];",
            f"    {name}_tool(model(), state, T);",
            *(
                f"    shift[{k}] = 1e-3 * *pins->tool_offset * (T[{place}][0] * z[0] + T[{place}][1] * z[1] +"
                f" T[{place}][2] * z[2]{' - 1.0' if place == 2 else ''});"
                for k, place in moved
            ),
            "  }",
        ]
    home = [f"    x[{k}] = {float(value)!r};" for k, value in enumerate(robot.home_coordinates)]
    texts = {
        "GET": "\n".join(f"  x[{k}] = world->{_MEMBERS[letter]} * axis_unit[{k}];" for letter, k in pairs),
        "PUT": "\n".join(f"  world->{_MEMBERS[letter]} = x[{k}] / axis_unit[{k}];" for letter, k in pairs),
        "SHIFT": "\n".join(shift),
        "HOME": "\n".join(home),
        "TOOL_FRAME": "\n".join(frame),
        "JOINT_UNITS": ", ".join(_unit(c) for c in robot.command_coordinates),
        "AXIS_UNITS": ", ".join(_unit(c) for c in robot.coordinates),
        "AXIS_INDICES": ", ".join(str(_INDICES[letter]) for letter in axes.letters),
        "SWITCH": f"*pins->calibrated ? &{name}_calibrated : &{name}_nominal" if is_calibrated else f"&{name}_nominal",
        "HAS_CALIBRATED": str(int(is_calibrated)),
        "UPPER": name.upper(),
        "MODULE": machine.module,
        "ROBOT": robot.name.replace("*/", ""),
        "NAME": name,
    }
    return re.sub("@([A-Z_]+)@", lambda token: texts[token[1]], _MODULE)


def _unit(coordinate: Coordinate) -> str:
    return "1e-3" if coordinate.unit == "m" else repr(math.pi / 180.0)


def _hal(machine: _Machine) -> str:
    count = len(machine.robot.commands)
    lines = [
        f"# HAL of {machine.robot.name}: joints are fed back to themselves. For a machine replace the joints' lines by",
        "# those of its drives, stepgen or encoders; everything else stays.",
        f"loadrt {machine.module}",
        f"loadrt [EMCMOT]EMCMOT servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints={count}",
        "addf motion-command-handler servo-thread",
        "addf motion-controller servo-thread",
        "",
        *(f"net j{k}-pos joint.{k}.motor-pos-cmd => joint.{k}.motor-pos-fb" for k in range(count)),
        "",
        f"net tool-length motion.tooloffset.z => {machine.module}.tool-offset",
        "net estop-loop iocontrol.0.user-enable-out => iocontrol.0.emc-enable-in",
        "net tool-prepare iocontrol.0.tool-prepare => iocontrol.0.tool-prepared",
        "net tool-change iocontrol.0.tool-change => iocontrol.0.tool-changed",
    ]
    if "calibrated" in machine.controller.models:
        lines.append(f"setp {machine.module}.calibrated 1")
    return "\n".join([*lines, ""])


def _ini(machine: _Machine) -> str:
    robot, limits, axes = machine.robot, machine.limits, machine.axes
    lower, upper = coordinate_ranges(robot, robot.coordinates)
    speed, acceleration = limits.speed * machine.shown, limits.acceleration * machine.shown
    linear = [k for k, c in enumerate(robot.coordinates) if c.unit == "m"]
    fastest = float(speed[linear].max()) if linear else float(speed.max())
    quickest = float(acceleration[linear].max()) if linear else float(acceleration.max())
    source = "assumed: the description has none" if limits.assumed else "as described"
    lines = [
        f"# {robot.name}: millimetres, degrees. Written by pm3dof export linuxcnc, for LinuxCNC 2.9.",
        "# Speeds and accelerations of the axes: at the same time in any directions they keep every drive within its",
        f"# own ({source}; a tenth of a second to full speed), at {limits.poses} random poses of the workspace.",
        "# LinuxCNC does not enforce joint limits of speed in coordinated moves: these do.",
        "[EMC]",
        "VERSION = 1.1",
        f"MACHINE = {machine.name}",
        "[DISPLAY]",
        "DISPLAY = axis",
        "[TASK]",
        "TASK = milltask",
        "CYCLE_TIME = 0.001",
        "[RS274NGC]",
        "PARAMETER_FILE = linuxcnc.var",
        "[EMCMOT]",
        "EMCMOT = motmod",
        "COMM_TIMEOUT = 1.0",
        "SERVO_PERIOD = 1000000",
        "[EMCIO]",
        "EMCIO = io",
        "CYCLE_TIME = 0.100",
        "TOOL_TABLE = tool.tbl",
        "[HAL]",
        f"HALFILE = {machine.name}.hal",
        "[KINS]",
        f"KINEMATICS = {machine.module}",
        f"JOINTS = {len(robot.commands)}",
        "[TRAJ]",
        f"COORDINATES = {' '.join(sorted(axes.letters, key=_INDICES.__getitem__))}",
        "LINEAR_UNITS = mm",
        "ANGULAR_UNITS = degree",
        f"DEFAULT_LINEAR_VELOCITY = {0.25 * fastest:.6f}",
        f"MAX_LINEAR_VELOCITY = {fastest:.6f}",
        f"MAX_LINEAR_ACCELERATION = {quickest:.6f}",
    ]
    for k, letter in enumerate(axes.letters):
        lines += [
            f"[AXIS_{letter}]",
            f"# {robot.coordinates[k].name}",
            f"MIN_LIMIT = {lower[k] * machine.shown[k]:.6f}",
            f"MAX_LIMIT = {upper[k] * machine.shown[k]:.6f}",
            f"MAX_VELOCITY = {speed[k]:.6f}",
            f"MAX_ACCELERATION = {acceleration[k]:.6f}",
        ]
    lower, upper = coordinate_ranges(robot, robot.command_coordinates)
    at_home = robot.at([robot.home.q]).commands[0] * machine.joint_shown
    for k, command in enumerate(robot.commands):
        shown = machine.joint_shown[k]
        lines += [
            f"[JOINT_{k}]",
            f"# {command.name}",
            f"TYPE = {'LINEAR' if command.unit == 'm' else 'ANGULAR'}",
            f"MIN_LIMIT = {lower[k] * shown - 1e-6:.6f}",
            f"MAX_LIMIT = {upper[k] * shown + 1e-6:.6f}",
            f"MAX_VELOCITY = {limits.drive_speed[k] * shown:.6f}",
            f"MAX_ACCELERATION = {limits.drive_acceleration[k] * shown:.6f}",
            "FERROR = 1.0",
            "MIN_FERROR = 0.1",
            "# no search: the drive is where it is at home",
            f"HOME = {at_home[k]:.12f}",
            f"HOME_OFFSET = {at_home[k]:.12f}",
            "HOME_SEARCH_VEL = 0.0",
            "HOME_LATCH_VEL = 0.0",
            "HOME_SEQUENCE = 0",
        ]
    return "\n".join([*lines, ""])


def _program(machine: _Machine, stops: Matrix) -> str:
    """Return the program that moves to the stops, and pauses at each."""
    lines = [
        f"(stops of {machine.name}: the joints there are in check_joints.csv)",
        "G21 G90 G61 G94",
    ]
    for stop in stops:
        words = " ".join(
            f"{letter}{value:.{_DIGITS}f}" for letter, value in zip(machine.axes.letters, stop, strict=True)
        )
        lines += [f"G0 {words}", "G4 P0.1", "M0"]
    return "\n".join([*lines, "M2", ""])


_CHECK = '''#!/usr/bin/python3
"""Run check.ngc in LinuxCNC and compare the joints at its stops with check_joints.csv: exit status 0 if they agree.

It takes the place of the display: DISPLAY = check.py in the INI file. run_sim.sh does that.
"""

import csv
import sys
import time
from pathlib import Path

import linuxcnc

FOLDER = Path(__file__).resolve().parent
TOLERANCE_OF_JOINTS = @TOLERANCE@  # mm, deg
command, status, errors = linuxcnc.command(), linuxcnc.stat(), linuxcnc.error_channel()


def wait(condition, what, seconds=60.0):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        status.poll()
        found = errors.poll()
        if found and found[0] in (linuxcnc.NML_ERROR, linuxcnc.OPERATOR_ERROR):
            sys.exit(f"LinuxCNC: {found[1]}")
        if condition():
            return
        time.sleep(0.002)
    sys.exit(f"no {what} within {seconds:g} s")


def main():
    program = Path(sys.argv[1]) if len(sys.argv) > 1 and sys.argv[1].endswith(".ngc") else FOLDER / "check.ngc"
    with open(FOLDER / "check_joints.csv", newline="", encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    joints = [k for k, name in enumerate(header) if name.startswith("joint_")]
    command.state(linuxcnc.STATE_ESTOP_RESET)
    wait(lambda: status.task_state != linuxcnc.STATE_ESTOP, "reset of the emergency stop")
    command.state(linuxcnc.STATE_ON)
    wait(lambda: status.task_state == linuxcnc.STATE_ON, "machine on")
    command.mode(linuxcnc.MODE_MANUAL)
    command.wait_complete()
    command.home(-1)
    wait(lambda: all(status.homed[: len(joints)]), "homing")
    command.teleop_enable(1)
    command.mode(linuxcnc.MODE_AUTO)
    command.wait_complete()
    command.program_open(str(program))
    command.auto(linuxcnc.AUTO_RUN, 0)
    worst = 0.0
    for number, row in enumerate(rows, start=1):
        wait(lambda: status.interp_state == linuxcnc.INTERP_PAUSED and status.inpos, f"stop {number}")
        off = max(abs(status.joint_position[k] - float(row[place])) for k, place in enumerate(joints))
        worst = max(worst, off)
        print(f"stop {number:2d}: joints off by at most {off:.2e}", flush=True)
        command.auto(linuxcnc.AUTO_RESUME)
        wait(lambda: status.interp_state != linuxcnc.INTERP_PAUSED, "resumption")
    print(f"worst {worst:.3e} mm or deg at {len(rows)} stops", flush=True)
    return 0 if worst <= TOLERANCE_OF_JOINTS else f"joints are off by {worst:.3e} mm or deg"


if __name__ == "__main__":
    sys.exit(main())
'''

_RUN = """#!/bin/sh
# Build the module and run check.ngc in LinuxCNC, without display, root or installation: the module is laid over
# LinuxCNC's folder of modules for this run only, in a user and mount namespace. Exit status 0 if all joints agree.
set -e
cd "$(dirname "$0")"
halcompile --compile @MODULE@.c >build.log 2>&1 || { cat build.log >&2; exit 1; }
sed 's/^DISPLAY = .*/DISPLAY = .\\/check.py/' @NAME@.ini >sim.ini
modules=${LINUXCNC_MODULES:-/usr/lib/linuxcnc/modules}
mkdir -p build home
chmod +x check.py
mv -f @MODULE@.so build/
export HOME="$PWD/home" modules
unshare -r -m -i -n -p --fork --kill-child --mount-proc sh -e -c '
  mount -t overlay overlay -o "lowerdir=$PWD/build:$modules" "$modules"
  ip link set lo up 2>/dev/null || true
  exec unshare -U --map-user=1000 linuxcnc -r "$PWD/sim.ini" </dev/null
'
"""


def _genhexkins(robot: Robot) -> str | None:
    """Return HAL lines for LinuxCNC's own genhexkins, if the robot is a hexapod with straight struts."""
    if len(robot.commands) != 6 or len(robot.coordinates) != 6 or robot.tool_frame is None:
        return None
    found = _struts(robot)
    if found is None:
        return None
    base, platform, offsets = found
    lines = [
        f"# {robot.name} in LinuxCNC's own genhexkins: KINEMATICS = genhexkins, and these lines in its HAL file [mm].",
        "# Its joints are lengths of the struts: the commands here plus "
        + ", ".join(f"{1e3 * o:.9f}" for o in offsets),
        "# Its angles are those of R = Rz(C) Ry(B) Rx(A), not of R = Rx(A) Ry(B) Rz(C).",
        "# Its first forward call ignores the pose before, and may find another assembly: home first.",
    ]
    for k, (fixed, moving) in enumerate(zip(base, platform, strict=True)):
        for word, point in (("base", fixed), ("platform", moving)):
            lines += [f"setp genhexkins.{word}.{k}.{c} {1e3 * p:.12f}" for c, p in zip("xyz", point, strict=True)]
    return "\n".join([*lines, ""])


def _struts(robot: Robot) -> tuple[Matrix, Matrix, Vector] | None:
    """Return points of the base, of the platform relative to the tool, and what to add to commands for lengths [m].

    None unless lengths between such points are the commands up to constants, at random poses.
    """
    home, model, drives = robot.home, robot.model, [robot.single_joint(c.joint) for c in robot.commands]
    tool = home.tool_placement
    supports = {
        name: list(model.supports[model.frames[robot.frame_id(name)].parentJoint])
        for loop in robot.closures
        for name in (loop.frame_a, loop.frame_b)
    }
    base, platform = [], []
    for drive in drives:
        index = model.getJointId(drive.name)
        ends = [
            (leg, other)
            for loop in robot.closures
            for leg, other in itertools.permutations((loop.frame_a, loop.frame_b))
            if index in supports[leg] and index not in supports[other]
        ]
        if len(ends) != 1:
            return None
        leg, other = ends[0]
        first = next(joint for joint in supports[leg] if joint != 0)
        base.append(np.array(model.jointPlacements[first].translation))
        platform.append(np.array(tool.actInv(home.frame_placement(other).translation)))
    fixed, moving = np.array(base), np.array(platform)
    poses = reachable_poses(robot, _STOPS, np.random.default_rng(_SEED))
    points = np.einsum("nij,kj->nki", poses.rotations, moving) + poses.positions[:, None]
    scales = np.array([c.scale for c in robot.commands])
    extra = np.linalg.norm(points - fixed, axis=-1) - poses.commands * np.sign(scales)
    if np.ptp(extra, axis=0).max() > _SAME or (scales < 0.0).any():
        return None
    return fixed, moving, extra.mean(axis=0)


def _readme(machine: _Machine) -> str:
    robot, name, module = machine.robot, machine.name, machine.module
    axes = ", ".join(
        f"{letter}: {coordinate.name} [{'mm' if coordinate.unit == 'm' else 'deg'}]"
        for letter, coordinate in zip(machine.axes.letters, robot.coordinates, strict=True)
    )
    joints = ", ".join(f"{k}: {c.name} [{'mm' if c.unit == 'm' else 'deg'}]" for k, c in enumerate(robot.commands))
    return f"""# {robot.name} in LinuxCNC

For LinuxCNC 2.9 (Debian: `linuxcnc-uspace`, `linuxcnc-uspace-dev`). Millimetres and degrees.

Axes: {axes}. Angles are those of R = Rx(A) Ry(B) Rz(C).
Joints: {joints}.

- `sh run_sim.sh` builds the module and runs `check.ngc` in LinuxCNC without display, root or installation (user
  namespaces must be allowed); exit status 0 if the joints at its stops are those of `check_joints.csv`, computed by
  Pinocchio.
- `halcompile --install {module}.c`, as root, installs the module; then `linuxcnc {name}.ini`.
- `{name}.hal` feeds joints back to themselves: put your drives there.
- Homing: `HOME` and `HOME_OFFSET` in `{name}.ini` are the counters at home, without search.
  The module answers with the pose at home until the joints are somewhere the loops close.
- Pins: `{module}.iterations`, Newton steps of the last call and 100 for each walk; `{module}.failures`;
  `{module}.tool-offset`, the tool's length along z [mm], for tilted tools; `{module}.calibrated`, which numbers it
  uses, if there are two sets.
- LinuxCNC checks joint positions at the ends of moves only: check a program with `pm3dof path` before it runs.
- `{module}.c` includes headers under the GPL and is under the GPL, version 2; `{name}.h` and `{name}_parameters.h` are
  not.
"""
