"""Kinematics for controllers as C99 that needs only `math.h`: no allocation, and no state but the caller's."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.export.controller import Controller, CorrectionTable
from pm3dof_pin.kinematics.shared_commands import AGREEING
from pm3dof_pin.kinematics.units import coordinate_periods, coordinate_scales
from pm3dof_pin.programs.c import Real, function_lines, harmless, in_type, number, walk_lines
from pm3dof_pin.programs.walk import LEG
from pm3dof_pin.typing import Array

_NEARLY_CLOSED = 1e-7  # closure error from which one quadratic step reaches rounding [characteristic lengths, rad]
_SINGLE_CLOSED = 4e-6  # closure error of single precision, relative to the machine's size [characteristic lengths, rad]
_SINGLE_NEARLY_CLOSED = 1e-4  # the same in single precision
_SELFTEST = 1e-9  # greatest difference from the golden poses [m, rad]
_SINGLE_SELFTEST = 8.0  # ratio of the same in single precision to the error found
_STEPS = 6
_APART = 0.01  # commands that differ by this are those of different poses [characteristic lengths, rad]
_MAX_STEPS = 400  # of a walk; most take 10 to 100

_PROTOTYPES = {
    "selftest": "int name_selftest(const name_model *model, double *worst)",
    "start": "void name_start(const name_model *model, name_state *state)",
    "inverse": "int name_inverse(const name_model *model, name_state *state, const double *coordinates,"
    " double *commands)",
    "forward": "int name_forward(const name_model *model, name_state *state, const double *commands,"
    " double *coordinates)",
    "jacobian": "int name_jacobian(const name_model *model, const name_state *state,"
    " double jac[NAME_COMMANDS][NAME_COORDINATES])",
    "limits": "unsigned name_limits(const name_model *model, const name_state *state)",
    "tool": "void name_tool(const name_model *model, const name_state *state, double transform[4][4])",
}

_HEADER = """#ifndef NAME_KINEMATICS_H
#define NAME_KINEMATICS_H

#define NAME_COORDINATES {m}
#define NAME_COMMANDS {k}
#define NAME_POSITIONS {nq}
#define NAME_NUMBERS {numbers}

/* Results of name_inverse, name_forward and name_jacobian. */
enum {{
  NAME_OK = 0,
  NAME_BEYOND = 1,        /* a singular configuration or another branch is on the way */
  NAME_OPEN = 2,          /* the loops do not close: out of reach */
  NAME_NO_NUMBER = 3,     /* an argument is not finite, or too far away */
  NAME_MANY_STEPS = 4,    /* NAME_MAX_STEPS Newton steps did not suffice */
  NAME_CONTRADICTION = 5  /* commands of redundant drives contradict each other */
}};

/* Newton steps after which a walk gives up; a call takes at most {steps} steps and {walks} walks. */
#ifndef NAME_MAX_STEPS
#define NAME_MAX_STEPS {max_steps}
#endif

/* Numbers of a robot: as described, or calibrated. */
typedef struct {{
  const double *numbers;    /* geometry; home; modes and branch there: NAME_NUMBERS + NAME_POSITIONS + 3 */
  const double *golden;     /* poses for name_selftest: coordinates, then commands */
  int n_golden;
  const double *correction; /* learned deviations of the commands, or 0, see name_deviations */
}} name_model;

/* The pose reached last, in memory of the caller; all zeros is a valid beginning: home. */
typedef struct {{
  double q[NAME_POSITIONS];       /* joint positions [m, rad] */
  double commands[NAME_COMMANDS]; /* commands there */
  double before[2][NAME_POSITIONS]; /* the positions of the two calls before, newest first */
  int n_before;
  int is_started;
  int steps; /* Newton steps of the last call, without those of walks */
  int walks; /* walks of the last call: 0 if the pose before was near */
}} name_state;
"""

_CORE = """
static int name_follow(int is_forward, int m, const double *targets, const double *p, double *q, int *steps)
{
  double x[NAME_POSITIONS + 2 + NAME_TARGETS], y[NAME_POSITIONS + 3], judged[4], is_accepted, branch;
  const double *const home = p + NAME_NUMBERS;
  int k, step;
  for (k = 0; k < NAME_POSITIONS; k++)
    x[k] = q[k];
  x[NAME_POSITIONS] = 1.0;
  x[NAME_POSITIONS + 1] = 0.0;
  for (k = 0; k < m; k++)
    x[NAME_POSITIONS + 2 + k] = targets[k];
  for (step = 0; step < NAME_STEPS; step++) {
    if (is_forward)
      name_forward_step(x, p, y);
    else
      name_inverse_step(x, p, y);
    ++*steps;
    if (!(y[NAME_POSITIONS + 1] < NAME_FARTHEST))
      return NAME_BEYOND;
    if (y[NAME_POSITIONS + 2] < NAME_NEARLY_CLOSED) {
      judged[0] = y[NAME_POSITIONS];
      judged[1] = y[NAME_POSITIONS + 1];
      judged[2] = 0.0;
      judged[3] = home[NAME_POSITIONS + (is_forward ? 1 : 0)];
      name_accept(judged, p, &is_accepted);
      if (is_accepted < 0.5)
        return NAME_BEYOND;
      name_branch(y, p, &branch);
      if (branch != home[NAME_POSITIONS + 2])
        return NAME_BEYOND;
      for (k = 0; k < NAME_POSITIONS; k++)
        q[k] = y[k];
      return NAME_OK;
    }
    for (k = 0; k < NAME_POSITIONS + 2; k++)
      x[k] = y[k];
  }
  return NAME_OPEN;
}

static int name_walk(int is_forward, const double *start, const double *targets, const double *p, double *q)
{
  return is_forward ? name_forward_walk(start, targets, p, NAME_MAX_STEPS, q)
                    : name_inverse_walk(start, targets, p, NAME_MAX_STEPS, q);
}

/* Write where a parabola through the last three poses leads, if they are those of a smooth motion; else the last. */
static void name_predict(const name_state *state, double *q)
{
  double moved = 0.0, bent = 0.0;
  int k;
  for (k = 0; k < NAME_POSITIONS; k++) {
    moved += fabs(state->q[k] - state->before[0][k]);
    bent += fabs(state->q[k] - 2.0 * state->before[0][k] + state->before[1][k]);
  }
  for (k = 0; k < NAME_POSITIONS; k++) {
    q[k] = state->q[k];
    if (NAME_IS_SMOOTH && state->n_before == 2 && bent < 0.1 * moved)
      q[k] += 2.0 * state->q[k] - 3.0 * state->before[0][k] + state->before[1][k];
  }
}

static void name_keep(name_state *state, const double *q)
{
  int k;
  for (k = 0; k < NAME_POSITIONS; k++) {
    state->before[1][k] = state->before[0][k];
    state->before[0][k] = state->q[k];
    state->q[k] = q[k];
  }
  state->n_before = state->walks ? 0 : state->n_before < 2 ? state->n_before + 1 : 2;
}

/* Follow from the poses before; or else walk from the last one, or from home. */
static int name_close(int is_forward, int m, const double *targets, const name_model *model, name_state *state,
                      double *q)
{
  const double *const p = model->numbers;
  int k, status = NAME_OPEN;
  state->steps = state->walks = 0;
  for (k = 0; k < m; k++)
    if (!isfinite(targets[k]))
      return NAME_NO_NUMBER;
  if (state->is_started) {
#if NAME_IS_PRECISE
    name_predict(state, q);
    status = name_follow(is_forward, m, targets, p, q, &state->steps);
#endif
    if (status != NAME_OK) {
      state->walks++;
      status = name_walk(is_forward, state->q, targets, p, q);
    }
  }
  if (status != NAME_OK) {
    state->walks++;
    status = name_walk(is_forward, p + NAME_NUMBERS, targets, p, q);
  }
  return status;
}

static void name_place(const double *coordinates, double *targets)
{
INVERSE_TARGETS
}

DECLARE_start
{
  double y[NAME_READINGS];
  int k;
  for (k = 0; k < NAME_POSITIONS; k++)
    state->q[k] = model->numbers[NAME_NUMBERS + k];
  name_readings(state->q, model->numbers, y);
  for (k = 0; k < NAME_COMMANDS; k++)
    state->commands[k] = y[k];
  state->is_started = 1;
  state->steps = state->walks = state->n_before = 0;
}

DECLARE_inverse
{
  double targets[NAME_TARGETS], q[NAME_POSITIONS], y[NAME_READINGS];
  int k, status;
  name_place(coordinates, targets);
  status = name_close(0, NAME_COORDINATES, targets, model, state, q);
#if NAME_WAYPOINTS
  for (k = 0; k < model->n_golden && status != NAME_OK && status != NAME_NO_NUMBER; k++) {
    double waypoint[NAME_TARGETS], via[NAME_POSITIONS];
    name_place(model->golden + k * (NAME_COORDINATES + NAME_COMMANDS), waypoint);
    state->walks += 2;
    if (name_walk(0, model->numbers + NAME_NUMBERS, waypoint, model->numbers, via) == NAME_OK)
      status = name_walk(0, via, targets, model->numbers, q);
  }
#endif
  if (status != NAME_OK)
    return status;
  if (!state->is_started)
    name_start(model, state);
  name_readings(q, model->numbers, y);
PERIODIC
  name_keep(state, q);
  for (k = 0; k < NAME_COMMANDS; k++)
    state->commands[k] = y[k];
CORRECTED
  for (k = 0; k < NAME_COMMANDS; k++)
    commands[k] = y[k];
  return NAME_OK;
}

#if NAME_HAS_BRANCHES
/* Whether the walk from home to the coordinates of a pose ends elsewhere: legs that flip in pairs leave the signs that
   tell branches apart as they are. */
static int name_is_elsewhere(const name_model *model, const double *y)
{
  double targets[NAME_TARGETS], q[NAME_POSITIONS], there[NAME_READINGS], error;
  int k;
  name_place(y + NAME_COMMANDS, targets);
  if (name_walk(0, model->numbers + NAME_NUMBERS, targets, model->numbers, q) != NAME_OK)
    return 0; /* it leaves the workspace */
  name_readings(q, model->numbers, there);
  for (k = 0; k < NAME_COMMANDS; k++) {
    error = there[k] - y[k];
    if (name_turns[NAME_COORDINATES + k] > 0.0)
      error -= name_turns[NAME_COORDINATES + k] * floor(error / name_turns[NAME_COORDINATES + k] + 0.5);
    if (fabs(error) > name_apart[k])
      return 1;
  }
  return 0;
}

#endif
DECLARE_forward
{
  double targets[NAME_TARGETS], given[NAME_COMMANDS], q[NAME_POSITIONS], y[NAME_READINGS];
  int k, status;
  for (k = 0; k < NAME_COMMANDS; k++)
    given[k] = commands[k];
DEVIATED
FORWARD_TARGETS
  status = name_close(1, NAME_PLACING, targets, model, state, q);
  if (status != NAME_OK)
    return status;
  name_readings(q, model->numbers, y);
#if NAME_HAS_BRANCHES
  if (state->walks && name_is_elsewhere(model, y))
    return NAME_BEYOND;
#endif
CONTRADICTION
  name_keep(state, q);
  for (k = 0; k < NAME_COMMANDS; k++)
    state->commands[k] = given[k];
  state->is_started = 1;
  for (k = 0; k < NAME_COORDINATES; k++)
    coordinates[k] = y[NAME_COMMANDS + k];
  return NAME_OK;
}

DECLARE_jacobian
{
  double values[NAME_COMMANDS * NAME_COORDINATES + 1];
  int j, a;
  name_jacobian_values(state->q, model->numbers, values);
  if (values[NAME_COMMANDS * NAME_COORDINATES] < 0.5)
    return NAME_BEYOND;
  for (j = 0; j < NAME_COMMANDS; j++)
    for (a = 0; a < NAME_COORDINATES; a++)
      jac[j][a] = values[j * NAME_COORDINATES + a];
  return NAME_OK;
}

DECLARE_limits
{
  double y[NAME_CHECKS];
  name_checks(state->q, model->numbers, y);
  return (unsigned)y[1] >> 1;
}
TOOL
DECLARE_selftest
{
  double found[NAME_COORDINATES + NAME_COMMANDS] = {0.0}, error;
  int n, k, way, failed = 0;
  name_state state;
  name_model plain = *model;
  plain.correction = 0;
  *worst = 0.0;
  name_start(&plain, &state);
  for (n = 0; n < model->n_golden; n++) {
    const double *const golden = model->golden + n * (NAME_COORDINATES + NAME_COMMANDS);
    int is_wrong = 0;
    for (way = NAME_WAYPOINTS; way < 2; way++) { /* from the pose before (an arm keeps its posture), from home */
      if (way == 1)
        name_start(&plain, &state);
      if (name_inverse(&plain, &state, golden, found + NAME_COORDINATES) != NAME_OK)
        is_wrong = 1;
      if (way == 1)
        name_start(&plain, &state);
      if (name_forward(&plain, &state, golden + NAME_COORDINATES, found) != NAME_OK)
        is_wrong = 1;
      for (k = 0; k < NAME_COORDINATES + NAME_COMMANDS && !is_wrong; k++) {
        error = found[k] - golden[k];
        if (name_turns[k] > 0.0)
          error -= name_turns[k] * floor(error / name_turns[k] + 0.5);
        error = fabs(error) / name_units[k];
        if (error > *worst)
          *worst = error;
        if (!(error < NAME_SELFTEST))
          is_wrong = 1;
      }
    }
    failed += is_wrong;
  }
  return failed;
}
"""

_TOOL = """
DECLARE_tool
{
  double y[NAME_READINGS];
  int i, j;
  name_readings(state->q, model->numbers, y);
  for (i = 0; i < 4; i++)
    for (j = 0; j < 4; j++)
      transform[i][j] = y[NAME_COMMANDS + NAME_COORDINATES + 4 * i + j];
}
"""

_DEVIATIONS = """
/* Interpolate learned deviations at commands: first node, distance of nodes, values of a drive after the other. */
static void name_deviations(const double *table, const double *commands, double *deviations)
{
  int first[NAME_COMMANDS], k, corner, index;
  double share[NAME_COMMANDS], weight, place;
  for (k = 0; k < NAME_COMMANDS; k++) {
    place = (commands[k] - table[k]) / table[NAME_COMMANDS + k];
    place = place > 0.0 ? place : 0.0;
    place = place < NAME_NODES - 1 ? place : NAME_NODES - 1;
    first[k] = (int)place < NAME_NODES - 2 ? (int)place : NAME_NODES - 2;
    share[k] = place - first[k];
    deviations[k] = 0.0;
  }
  for (corner = 0; corner < 1 << NAME_COMMANDS; corner++) {
    weight = 1.0;
    index = 0;
    for (k = 0; k < NAME_COMMANDS; k++) {
      weight *= corner >> k & 1 ? share[k] : 1.0 - share[k];
      index = index * NAME_NODES + first[k] + (corner >> k & 1);
    }
    for (k = 0; k < NAME_COMMANDS; k++)
      deviations[k] += weight * table[2 * NAME_COMMANDS + index * NAME_COMMANDS + k];
  }
}
"""

_CORRECTED = """  if (model->correction) {
    double corrected[NAME_COMMANDS], deviations[NAME_COMMANDS];
    int round;
    for (k = 0; k < NAME_COMMANDS; k++)
      corrected[k] = y[k];
    for (round = 0; round < 8; round++) { /* deviations change little between commands: each round gains digits */
      name_deviations(model->correction, corrected, deviations);
      for (k = 0; k < NAME_COMMANDS; k++)
        corrected[k] = y[k] - deviations[k];
    }
    for (k = 0; k < NAME_COMMANDS; k++)
      y[k] = corrected[k];
  }"""

_DEVIATED = """  if (model->correction) {
    double deviations[NAME_COMMANDS];
    name_deviations(model->correction, commands, deviations);
    for (k = 0; k < NAME_COMMANDS; k++)
      given[k] += deviations[k];
  }"""


def c_files(controller: Controller, *, real: Real = "double", header_only: bool = False) -> dict[str, str]:
    """Print a robot's kinematics as C99: texts by path.

    `NAME.h` declares the functions and says their units; `NAME.c` has them, unless the header does (`header_only`, as
    static inline functions); `NAME_parameters.h` has all numbers. In single precision (`real`) the header says what
    error that leaves.
    """
    name = controller.name
    linkage = "static inline " if header_only else ""
    static = "static " if header_only else ""
    comment, parts = _comment(controller, real), [_header(controller), *_declarations(controller, linkage)]
    header, declarations, core = (
        in_type(text, real) for text in (parts[0], "\n".join(parts[1:]), _core(controller, real, linkage))
    )
    numbers = f'#include "{name}_parameters.h"\n'
    if header_only:
        files = {f"{name}.h": [comment, header, declarations, "#include <math.h>", numbers, core, "#endif\n"]}
    else:
        models = [f"extern const name_model name_{model};" for model in controller.models]
        opening = '#ifdef __cplusplus\nextern "C" {\n#endif\n'
        ending = "#ifdef __cplusplus\n}\n#endif\n\n#endif\n"
        files = {
            f"{name}.h": [comment, header, opening, *models, "", declarations, ending],
            f"{name}.c": [comment, f'#include "{name}.h"\n', "#include <math.h>", numbers, core],
        }
    texts = {path: _named("\n".join(lines), name) for path, lines in files.items()}
    return {**texts, f"{name}_parameters.h": _parameters(controller, real, static)}


def _named(text: str, name: str) -> str:
    """Put a robot's name into a text."""
    return re.sub(r"\bNAME_", f"{name.upper()}_", re.sub(r"\bname_", f"{name}_", text))


def _header(controller: Controller) -> str:
    return _HEADER.format(
        m=len(controller.robot.coordinates),
        k=len(controller.robot.commands),
        nq=controller.inverse.nq,
        numbers=len(controller.parameters),
        steps=_STEPS,
        walks=max(_walks(controller, way) for way in ("inverse", "forward")),
        max_steps=_MAX_STEPS,
    )


def _comment(controller: Controller, real: Real) -> str:
    """Return the comment at the head of the files."""
    robot = controller.robot
    home = robot.at([robot.home.q]).coordinates[0] + 0.0
    lines = [
        f"Kinematics of {robot.name}, written by pm3dof export c. C99; needs only math.h. Lengths in m, angles in rad.",
        "No memory is allocated, and no state is kept but the caller's: calls with different states may run at once.",
        "",
        "coordinates, which place the tool:",
        *_rows(robot.coordinates, [robot.range_of(c) for c in robot.coordinates]),
        "commands, the counters of the drives:",
        *_rows(robot.command_coordinates, [robot.range_of(c) for c in robot.command_coordinates]),
        "home, where a state of all zeros begins:",
        *(f"  {c.name} = {value:.9g} {c.unit}" for c, value in zip(robot.coordinates, home, strict=True)),
        "limits, bits of what name_limits returns:",
        *(f"  {1 << bit}: {group.name}" for bit, group in enumerate(robot.limit_groups)),
    ]
    if robot.tool_frame is not None:
        lines.append(f"tool: {robot.tool_frame}; angles are those of R = Rx(rx) Ry(ry) Rz(rz) from base to tool")
    for model_name, model in controller.models.items():
        if model.correction is not None:
            lines.append(
                f"learned correction of name_{model_name}: a table of {model.correction.values.shape[0]} values a "
                f"drive, off by at most {model.correction.error:.1e} m or rad from what was learned, at "
                "2000 random commands; clamped outside"
            )
    lines += ["operations of a call, sums, products, sines and all others alike:", *_operations(controller)]
    if real == "float":
        lines.append(
            f"Single precision: errors up to {controller.single_precision_error:.1e} m or rad at the golden poses."
        )
    body = "\n".join(f" * {_named(harmless(line), controller.name)}".rstrip() for line in lines)
    return f"/*\n{body}\n */"


def _walks(controller: Controller, way: str) -> int:
    """Return the most walks of a call: from the pose before, from home, and those of the robot's kind.

    Where there are branches, forward goes from home to what it found; of an arm, inverse goes by each golden pose.
    """
    own = 0
    if way == "forward":
        own = int(controller.robot.has_branches)
    elif not controller.robot.has_loops:
        own = 2 * max(len(model.golden) for model in controller.models.values())
    return 2 + own


def _operations(controller: Controller) -> list[str]:
    """Return lines that bound the operations of a call: of one Newton step, of the most of these, and of all walks."""
    count = {name: len(program.lines) for name, program in controller.programs.items()}
    judged = count["accept"] + count["branch"] + count["readings"]
    lines = []
    for way, walk in (("inverse", controller.inverse), ("forward", controller.forward)):
        part = {name: len(program.lines) for name, program in walk.parts.items()}
        near = _STEPS * part["step"] + judged
        walked = part["start"] + _MAX_STEPS * (part["step"] + part["control"]) + 2 * count["branch"]
        walks = _walks(controller, way)
        lines.append(
            f"  {way}: {part['step'] + judged} along a smooth motion, at most {near} near the pose before, and "
            f"{near + walks * walked} with walks"
        )
    return lines


def _rows(coordinates: Iterable[Coordinate], ranges: Iterable[tuple[float, float]]) -> list[str]:
    return [
        f"  [{k}] {coordinate.name} [{coordinate.unit}], {lower:.6g} to {upper:.6g}"
        for k, (coordinate, (lower, upper)) in enumerate(zip(coordinates, ranges, strict=True))
    ]


def _declarations(controller: Controller, linkage: str) -> list[str]:
    """Return the comments and prototypes of the functions."""
    comments = {
        "start": "Begin at home.",
        "inverse": "Compute the commands of a pose; they are written only if the result is NAME_OK.\n"
        "   Follows from the state's pose with few Newton steps, or else walks there from it or from home, in\n"
        "   steps short enough to stay on the branch of home. Commands of drives that turn without end continue.",
        "forward": "Compute the pose at commands, as above. After a walk, that of inverse from home to the pose\n"
        "   must give the same commands, if it arrives.",
        "jacobian": "Rates of the commands by those of the coordinates at the state's pose, jac[j][a] = du_j/dx_a;\n"
        "   NAME_BEYOND if the pose is singular.",
        "limits": "Limits that the state's pose breaks, as bits.",
        "tool": "Placement of the tool in the base at the state's pose, a homogeneous transform.",
        "selftest": "Compare with poses computed by Pinocchio; returns how many are wrong by more than rounding, and\n"
        "   the worst difference [m, rad; of the drives' joints].",
    }
    chosen = [each for each in comments if each != "tool" or controller.robot.tool_frame is not None]
    return [f"/* {comments[each]} */\n{linkage}{_PROTOTYPES[each]};\n" for each in chosen]


def _core(controller: Controller, real: Real, linkage: str) -> str:
    """Return the functions, with name_ and NAME_ in place of the robot's name."""
    robot, programs = controller.robot, controller.programs
    commands, placing = robot.command_coordinates, robot.placing_drives
    size = robot.length_unit
    tolerance = robot.closure_tolerance if real == "double" else max(robot.closure_tolerance, _SINGLE_CLOSED * size)
    nearly = _NEARLY_CLOSED * size if real == "double" else _SINGLE_NEARLY_CLOSED * size
    selftest = _SELFTEST
    if real == "float":
        selftest = _SINGLE_SELFTEST * max(controller.single_precision_error, float(np.finfo(np.float32).eps))
    described = (*robot.coordinates, *commands)
    turns = np.nan_to_num(coordinate_periods(robot, described), posinf=0.0).tolist()
    apart = [_APART * abs(c.scale) * (size if robot.single_joint(c.joint).translates else 1.0) for c in robot.commands]
    tables = [model.correction for model in controller.models.values() if model.correction is not None]
    defines = {
        "TARGETS": max(len(robot.coordinates), len(placing)),
        "PLACING": len(placing),
        "READINGS": len(programs["readings"].results),
        "CHECKS": len(programs["checks"].results),
        "STEPS": _STEPS,
        "HAS_BRANCHES": int(robot.has_branches),
        "WAYPOINTS": int(not robot.has_loops),  # an arm goes round singular poses, by golden ones
        "IS_PRECISE": int(tolerance <= nearly),
        "IS_SMOOTH": int(robot.model.nq == robot.model.nv),  # else positions are no numbers to extrapolate
        "FARTHEST": LEG,
        "NEARLY_CLOSED": nearly,
        "SELFTEST": selftest,
        **({"NODES": tables[0].values.shape[0]} if tables else {}),
    }
    text = _CORE.replace("TOOL\n", _TOOL if robot.tool_frame is not None else "")
    replaced = {
        "INVERSE_TARGETS": _targets(controller, robot.coordinates, "coordinates", range(len(robot.coordinates))),
        "FORWARD_TARGETS": _targets(controller, robot.placing_commands, "given", placing),
        "PERIODIC": _periodic(controller),
        "CONTRADICTION": _contradiction(controller),
        "CORRECTED": _CORRECTED if tables else "",
        "DEVIATED": _DEVIATED if tables else "",
        **{f"DECLARE_{each}": f"{linkage}{prototype}" for each, prototype in _PROTOTYPES.items()},
    }
    for token, part in replaced.items():
        text = text.replace(f"\n{token}\n", f"\n{part}\n" if part else "\n")
    functions: list[str] = []
    for part, program in programs.items():
        function = "jacobian_values" if part == "jacobian" else part
        functions += function_lines(program, f"name_{function}", linkage="static ", real=real)
    for way, walk in (("inverse", controller.inverse), ("forward", controller.forward)):
        functions += walk_lines(
            replace(walk, tolerance=tolerance),
            f"name_{way}_walk",
            linkage="static ",
            branch="name_branch",
            real=real,
        )
    functions = [re.sub(r"\bname_(inverse|forward)_walk_", r"name_\1_", line) for line in functions]
    return "\n".join(
        [
            *(f"#define NAME_{key} {value!r}" for key, value in defines.items()),
            "",
            _row("units", [abs(c.scale) for c in described], real),
            _row("turns", turns, real),
            *([_row("apart", apart, real)] if robot.has_branches else []),
            "",
            *functions,
            *([_DEVIATIONS] if tables else []),
            text,
        ]
    )


def _row(name: str, values: Sequence[float], real: Real) -> str:
    return f"static const double name_{name}[{len(values)}] = {{{', '.join(number(each, real) for each in values)}}};"


def _targets(controller: Controller, coordinates: Sequence[Coordinate], array: str, indices: Sequence[int]) -> str:
    """Return assignments of a walk's targets."""
    lines = []
    for k, place in enumerate(controller.order(coordinates)):
        coordinate = coordinates[place]
        value = f"{array}[{indices[place]}]"
        if coordinate.offset:
            value = f"({value} - {number(coordinate.offset)})"
        lines.append(f"  targets[{k}] = {value}{'' if coordinate.scale == 1.0 else f' / {number(coordinate.scale)}'};")
    return "\n".join(lines)


def _periodic(controller: Controller) -> str:
    """Return lines that let the commands of drives that turn without end continue from the ones before."""
    robot = controller.robot
    lines = []
    for k, command in enumerate(robot.command_coordinates):
        assert command.joint is not None
        if robot.single_joint(command.joint).is_continuous:
            turn = number(2.0 * np.pi * abs(command.scale))
            lines.append(f"  y[{k}] += {turn} * floor((state->commands[{k}] - y[{k}]) / {turn} + 0.5);")
    return "\n".join(lines)


def _contradiction(controller: Controller) -> str:
    """Return lines that compare the commands of redundant drives."""
    robot = controller.robot
    commands = robot.command_coordinates
    scales, turns = coordinate_scales(robot, commands), coordinate_periods(robot, commands)
    lines = []
    for k in sorted(set(range(len(commands))) - set(robot.placing_drives)):
        off = f"y[{k}] - given[{k}]"
        if np.isfinite(turns[k]):
            turn = number(float(turns[k]))
            off = f"{off} - {turn} * floor(({off}) / {turn} + 0.5)"
        lines.append(f"  if (!(fabs({off}) <= {number(AGREEING * float(scales[k]))}))\n    return NAME_CONTRADICTION;")
    return "\n".join(lines)


def _parameters(controller: Controller, real: Real, linkage: str) -> str:
    """Return the file of numbers."""
    name, nq = controller.name, controller.inverse.nq
    names = [*controller.parameters, *(f"home q[{k}]" for k in range(nq))]
    names += ["mode of inverse at home", "mode of forward at home", "branch of home"]
    lines = [
        f"/* Numbers of {harmless(controller.robot.name)}: m and rad. */",
        f"#ifndef {name.upper()}_PARAMETERS_H",
        f"#define {name.upper()}_PARAMETERS_H",
        "",
        f'#include "{name}.h"' if not linkage else "",
    ]
    for model_name, model in controller.models.items():
        prefix = f"{name}_{model_name}"
        lines += _table(f"{prefix}_numbers", model.numbers, real, names)
        lines += _table(f"{prefix}_golden", model.golden, real)
        if model.correction is not None:
            lines += _table(f"{prefix}_correction", _flat(model.correction), real)
        correction = "0" if model.correction is None else f"{prefix}_correction"
        entries = f"{prefix}_numbers, {prefix}_golden, {len(model.golden)}, {correction}"
        lines += [f"{linkage}const {name}_model {prefix} = {{{entries}}};", ""]
    return "\n".join([*lines, "#endif", ""])


def _flat(table: CorrectionTable) -> Array:
    return np.concatenate([table.lower, table.step, table.values.ravel()])


def _table(name: str, values: Array, real: Real, names: Sequence[str] = ()) -> list[str]:
    """Return the lines of a table, one number a line with its name, or one row a line."""
    flat = [number(value, real) for value in np.ravel(values).tolist()]
    if names:
        rows = [f"  {value}, /* {harmless(each)} */" for value, each in zip(flat, names, strict=True)]
    else:
        width = values.shape[-1] if values.ndim > 1 else 3
        rows = [f"  {', '.join(flat[k : k + width])}," for k in range(0, len(flat), width)]
    size = max(len(flat), 1)
    return [f"static const {real} {name}[{size}] = {{", *(rows or ["  0"]), "};", ""]
