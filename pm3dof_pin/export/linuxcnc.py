"""A LinuxCNC configuration: kinematics module, HAL and INI files, a program of checks and a headless run of it."""

from __future__ import annotations

from pm3dof_pin.export.c_kinematics import c_files
from pm3dof_pin.export.controller import Controller
from pm3dof_pin.export.genhexkins import genhexkins_hal
from pm3dof_pin.export.linuxcnc_check import check_script, run_script
from pm3dof_pin.export.linuxcnc_module import linuxcnc_module
from pm3dof_pin.export.machine_axes import AXIS_INDICES, DIGITS, Machine
from pm3dof_pin.export.template import markdown, one_line
from pm3dof_pin.files import csv_text
from pm3dof_pin.kinematics.coordinate_ranges import coordinate_ranges
from pm3dof_pin.typing import Matrix


def linuxcnc_files(controller: Controller) -> dict[str, str]:
    """Return the files of a configuration: texts by path."""
    machine = Machine(controller)
    name, module = machine.name, f"{machine.name}_kins"
    stops, joints = machine.stops
    head = [f"stop {letter}" for letter in machine.axes.letters]
    head += [f"joint_{k}" for k in range(joints.shape[1])]
    rows = [
        [*map(repr, stop), *map(repr, values)] for stop, values in zip(stops.tolist(), joints.tolist(), strict=True)
    ]
    hexapod = genhexkins_hal(machine.robot)
    return {
        **c_files(controller, header_only=True),
        f"{module}.c": linuxcnc_module(machine, module),
        f"{name}.hal": _hal(machine, module),
        f"{name}.ini": _ini(machine, module),
        **({} if hexapod is None else {"genhexkins.hal": hexapod}),
        "check.ngc": _program(machine, stops),
        "check_joints.csv": csv_text([head, *rows]),
        "check.py": check_script(),
        "run_sim.sh": run_script(name, module),
        "tool.tbl": "T1 P1 Z0 ;no tool\n",
        "README.md": _readme(machine, module),
    }


def _hal(machine: Machine, module: str) -> str:
    count = len(machine.robot.commands)
    lines = [
        f"# HAL of {one_line(machine.robot.name)}: joints are fed back to themselves. For a machine replace",
        "# the joints' lines by those of its drives, stepgen or encoders; everything else stays.",
        f"loadrt {module}",
        f"loadrt [EMCMOT]EMCMOT servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints={count}",
        "addf motion-command-handler servo-thread",
        "addf motion-controller servo-thread",
        "",
        *(f"net j{k}-pos joint.{k}.motor-pos-cmd => joint.{k}.motor-pos-fb" for k in range(count)),
        "",
        f"net tool-length motion.tooloffset.z => {module}.tool-offset",
        "net estop-loop iocontrol.0.user-enable-out => iocontrol.0.emc-enable-in",
        "net tool-prepare iocontrol.0.tool-prepare => iocontrol.0.tool-prepared",
        "net tool-change iocontrol.0.tool-change => iocontrol.0.tool-changed",
    ]
    if "calibrated" in machine.controller.models:
        lines.append(f"setp {module}.calibrated 1")
    return "\n".join([*lines, ""])


def _ini(machine: Machine, module: str) -> str:
    robot, limits, axes = machine.robot, machine.limits, machine.axes
    lower, upper = coordinate_ranges(robot, robot.coordinates)
    speed, acceleration = limits.speed * machine.shown, limits.acceleration * machine.shown
    linear = [k for k, c in enumerate(robot.coordinates) if c.unit == "m"]
    fastest = float(speed[linear].max()) if linear else float(speed.max())
    quickest = float(acceleration[linear].max()) if linear else float(acceleration.max())
    source = "assumed: the description has none" if limits.assumed else "as described"
    near = [
        f"# Left out: {limits.left_out} poses near singular ones, where drives run five times as fast as usual.",
        "# Moves there can exceed the drives' limits; pm3dof path --controller finds them.",
    ]
    lines = [
        f"# {one_line(robot.name)}: millimetres, degrees. Written by pm3dof export linuxcnc, for LinuxCNC 2.9.",
        "# Speeds and accelerations of the axes: at the same time in any directions they keep every drive within its",
        f"# own ({source}; a tenth of a second to full speed), at {limits.poses} random poses of the workspace.",
        *(near if limits.left_out else ()),
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
        f"KINEMATICS = {module}",
        f"JOINTS = {len(robot.commands)}",
        "[TRAJ]",
        f"COORDINATES = {' '.join(sorted(axes.letters, key=AXIS_INDICES.__getitem__))}",
        "LINEAR_UNITS = mm",
        "ANGULAR_UNITS = degree",
        f"DEFAULT_LINEAR_VELOCITY = {0.25 * fastest:.6f}",
        f"MAX_LINEAR_VELOCITY = {fastest:.6f}",
        f"MAX_LINEAR_ACCELERATION = {quickest:.6f}",
    ]
    for k, letter in enumerate(axes.letters):
        lines += [
            f"[AXIS_{letter}]",
            f"# {one_line(robot.coordinates[k].name)}",
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
            f"# {one_line(command.name)}",
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


def _program(machine: Machine, stops: Matrix) -> str:
    """Return the program that moves to the stops, and pauses at each."""
    lines = [
        f"(stops of {machine.name}: the joints there are in check_joints.csv)",
        "G21 G90 G61 G94",
    ]
    for stop in stops:
        words = " ".join(
            f"{letter}{value:.{DIGITS}f}" for letter, value in zip(machine.axes.letters, stop, strict=True)
        )
        lines += [f"G0 {words}", "G4 P0.1", "M0"]
    return "\n".join([*lines, "M2", ""])


def _readme(machine: Machine, module: str) -> str:
    robot, name = machine.robot, machine.name
    axes = ", ".join(
        f"{letter}: {markdown(coordinate.name)} [{'mm' if coordinate.unit == 'm' else 'deg'}]"
        for letter, coordinate in zip(machine.axes.letters, robot.coordinates, strict=True)
    )
    joints = ", ".join(
        f"{k}: {markdown(c.name)} [{'mm' if c.unit == 'm' else 'deg'}]" for k, c in enumerate(robot.commands)
    )
    return f"""# {markdown(robot.name)} in LinuxCNC

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
- The comment at the head of `{name}.h` bounds the operations of a call, which the servo period must leave time for.
- LinuxCNC checks joint positions at the ends of moves only: check a program with `pm3dof path` before it runs.
- `{module}.c` includes headers under the GPL and is under the GPL, version 2; `{name}.h` and `{name}_parameters.h` are
  not.
"""
