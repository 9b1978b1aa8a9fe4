"""Kinematics for grblHAL: a file for its `kinematics` interface, in which long moves are divided into short ones."""

from __future__ import annotations

import math

import numpy as np

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.export.c_kinematics import c_files
from pm3dof_pin.export.controller import Controller
from pm3dof_pin.export.machine_axes import AXIS_INDICES, Machine
from pm3dof_pin.export.template import fill, markdown
from pm3dof_pin.files import csv_text
from pm3dof_pin.kinematics.jacobians import jacobian
from pm3dof_pin.kinematics.reachable_poses import reachable_poses

MOST_AXES = 8
"""Greatest N_AXIS of the controller: X, Y, Z, A, B, C, U, V."""

_CHORD = 5e-6  # greatest deviation of drives that move evenly between two poses [m, rad]
_POSES, _SEED = 1000, 3


def grblhal_files(controller: Controller) -> dict[str, str]:
    """Return the files: texts by path.

    Raises:
        InvalidValueError: the controller has no axis for a coordinate or a drive.
        UnreachablePoseError: hardly any pose is within the limits, or moves between them are not.
    """
    machine = Machine(controller)
    if (count := _axis_count(machine)) > MOST_AXES:
        raise InvalidValueError(f"{controller.robot.name} in grblHAL", f"{count} axes", f"at most {MOST_AXES}")
    name = machine.name
    stops, joints = machine.stops
    head = [f"stop {letter}" for letter in machine.axes.letters] + [f"motor_{k}" for k in range(joints.shape[1])]
    return {
        **c_files(controller, header_only=True),
        f"{name}_grblhal.c": _source(machine),
        "check_motors.csv": csv_text([head, *np.hstack([stops, joints]).tolist()]),
        "README.md": _readme(machine),
    }


def _axis_count(machine: Machine) -> int:
    """Return the least number of axes that the controller must be built with: at least three."""
    return max(3, len(machine.robot.commands), *(AXIS_INDICES[letter] + 1 for letter in machine.axes.letters))


def _move_scale(machine: Machine) -> list[float]:
    """Return by how much a move is divided, by mm or degree of each axis.

    Drives that move evenly over a step d of the coordinates are off by at most d' H d / 8, H their second derivatives;
    with H in units of lengths for all coordinates its greatest singular value at random poses bounds that.
    """
    robot = machine.robot
    poses = reachable_poses(robot, _POSES, np.random.default_rng(_SEED))
    bent = jacobian(robot, poses, of="commands", by="coordinates", with_derivatives=True, on_failure="nan").derivatives
    assert bent is not None
    units = np.array([1.0 if c.unit == "m" else robot.characteristic_length for c in robot.coordinates])
    scales = np.array([abs(c.scale) for c in robot.commands])
    scaled = bent / scales[:, None, None] / (units[:, None] * units)
    known = scaled[np.isfinite(scaled).all(axis=(1, 2, 3))]
    greatest = float(np.linalg.norm(known, ord=2, axis=(2, 3)).max())
    share = math.sqrt(greatest / (8.0 * _CHORD))
    return [share * unit / shown for unit, shown in zip(units.tolist(), machine.shown.tolist(), strict=True)]


_SOURCE = """/*
 * Kinematics of @ROBOT@ for grblHAL; millimetres and degrees. Written by pm3dof export grblhal.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later
 * This file is under the GNU General Public License, version 3 or later, as the headers of grblHAL are.
 * @NAME@.h and @NAME@_parameters.h, which it includes, are not derived from grblHAL and stay under their own licence.
 *
 * Put the three files beside grbl.h, and build with KINEMATICS_API defined and N_AXIS of at least @AXES@.
 */
#include "grbl.h"

#ifndef KINEMATICS_API
#error "define KINEMATICS_API, in config.h or for the compiler"
#endif

#include <math.h>
#include <string.h>

#include "hal.h"
#include "settings.h"
#include "planner.h"
#include "system.h"
#include "kinematics/interface.h"

#include "@NAME@.h"

#define MOTORS @UPPER@_COMMANDS
#define PLACES @UPPER@_COORDINATES

#if N_AXIS < @AXES@
#error "@NAME@ needs N_AXIS of at least @AXES@"
#endif

static const uint8_t axis_of[PLACES] = {@AXIS_OF@}; /* X, Y, Z, A, B, C, U, V are 0 to 7 */
static const double axis_unit[PLACES] = {@AXIS_UNITS@}; /* mm or degree in m, rad */
static const double motor_unit[MOTORS] = {@MOTOR_UNITS@};
static const double pieces[PLACES] = {@PIECES@}; /* of a move, by mm or degree: drives off by @CHORD@ at most */

static @NAME@_state state;    /* of poses that are commanded */
static @NAME@_state measured; /* of poses from steps */
static bool stopped, homing;
static on_jog_cancel_ptr on_jog_cancel;
static on_homing_completed_ptr on_homing_completed;
static on_report_options_ptr on_report_options;

static struct {
  coord_data_t start, end, motors, motors_before;
  uint32_t count, done;
  float piece; /* length of one, as the feed counts it */
} move;

static bool is_of_robot(uint_fast8_t axis)
{
  uint_fast8_t k;
  for (k = 0; k < PLACES; k++)
    if (axis_of[k] == axis)
      return true;
  return false;
}

/* Axes that the robot does not have are motors of their own, after its own, in order. */
static void copy_other_axes(float *to, const float *from, bool to_motors)
{
  uint_fast8_t axis, motor = MOTORS;
  for (axis = 0; axis < N_AXIS; axis++)
    if (!is_of_robot(axis)) {
      if (motor < N_AXIS) {
        if (to_motors)
          to[motor] = from[axis];
        else
          to[axis] = from[motor];
      } else if (!to_motors)
        to[axis] = 0.0f;
      motor++;
    }
}

static bool motors_of(@NAME@_state *from, const float *place, float *motors, bool *is_legal)
{
  double x[PLACES], commands[MOTORS];
  uint_fast8_t k;
  for (k = 0; k < PLACES; k++)
    x[k] = (double)place[axis_of[k]] * axis_unit[k];
  if (@NAME@_inverse(&@NAME@_@MODEL@, from, x, commands) != @UPPER@_OK)
    return false;
  if (is_legal)
    *is_legal = @NAME@_limits(&@NAME@_@MODEL@, from) == 0;
  copy_other_axes(motors, place, true);
  for (k = 0; k < MOTORS; k++)
    motors[k] = (float)(commands[k] / motor_unit[k]);
  return true;
}

static bool place_of(const float *motors, float *place)
{
  double x[PLACES], commands[MOTORS];
  uint_fast8_t k;
  for (k = 0; k < MOTORS; k++)
    commands[k] = (double)motors[k] * motor_unit[k];
  if (@NAME@_forward(&@NAME@_@MODEL@, &measured, commands, x) != @UPPER@_OK)
    return false;
  copy_other_axes(place, motors, false);
  for (k = 0; k < PLACES; k++)
    place[axis_of[k]] = (float)(x[k] / axis_unit[k]);
  return true;
}

/* Motors of a place; during homing they are moved one by one. */
static coord_data_t *from_cartesian(coord_data_t *target, coord_data_t *position)
{
  if (homing || !motors_of(&state, position->values, target->values, NULL))
    memcpy(target, position, sizeof(coord_data_t));
  return target;
}

static coord_data_t *steps_to_cartesian(coord_data_t *position, mpos_t *steps)
{
  coord_data_t motors;
  uint_fast8_t k;
  for (k = 0; k < N_AXIS; k++)
    motors.values[k] = (float)steps->values[k] / settings.axis[k].steps_per_mm;
  if (!place_of(motors.values, position->values)) /* not homed: motors are anything */
    memset(position, 0, sizeof(coord_data_t));
  return position;
}

static void at_piece(uint32_t piece, float *place)
{
  uint_fast8_t k;
  for (k = 0; k < N_AXIS; k++)
    place[k] = piece >= move.count ? move.end.values[k]
                                   : move.start.values[k] + (move.end.values[k] - move.start.values[k]) *
                                                              ((float)piece / (float)move.count);
}

static float distance(const float *one, const float *other)
{
  float sum = 0.0f;
  uint_fast8_t k;
  for (k = 0; k < N_AXIS; k++)
    sum += (one[k] - other[k]) * (one[k] - other[k]);
  return sqrtf(sum);
}

/* Divide a move: its start first, then a call for each piece, and NULL after the last. The whole move is compared with
 * the limits before any of it is run. */
static coord_data_t *segment_line(coord_data_t *target, coord_data_t *position, plan_line_data_t *plan, bool init)
{
  coord_data_t place;
  uint_fast8_t k;
  if (init) {
    @NAME@_state tried = state;
    double size = 0.0;
    bool is_legal = true;
    uint32_t piece;
    stopped = false;
    move.done = 0;
    memcpy(&move.end, target, sizeof(coord_data_t));
    memcpy(&move.motors, position, sizeof(coord_data_t));
    memcpy(&move.motors_before, position, sizeof(coord_data_t));
    if (!place_of(position->values, move.start.values))
      is_legal = false;
    for (k = 0; k < PLACES; k++) {
      const double part = (double)(move.end.values[axis_of[k]] - move.start.values[axis_of[k]]) * pieces[k];
      size += part * part;
    }
    move.count = is_legal ? (uint32_t)ceil(sqrt(size)) : 1;
    if (move.count == 0)
      move.count = 1;
    move.piece = distance(move.end.values, move.start.values) / (float)move.count;
    for (piece = 1; piece <= move.count && is_legal; piece++) {
      bool is_within = false;
      at_piece(piece, place.values);
      is_legal = motors_of(&tried, place.values, move.motors.values, &is_within) && is_within;
    }
    memcpy(&move.motors, position, sizeof(coord_data_t));
    plan->condition.target_validated = On;
    plan->condition.target_valid = is_legal;
    if (!is_legal) {
      system_set_exec_alarm(Alarm_SoftLimit);
      stopped = true;
    }
    return &move.motors;
  }
  if (stopped || move.done >= move.count)
    return NULL;
  at_piece(++move.done, place.values);
  if (!motors_of(&state, place.values, move.motors.values, NULL)) {
    system_set_exec_alarm(Alarm_SoftLimit);
    stopped = true;
    return NULL;
  }
  if (plan->condition.inverse_time)
    plan->feed_rate *= (float)move.count;
  else if (!plan->condition.rapid_motion && move.piece > 0.0f) {
    const float ratio = distance(move.motors.values, move.motors_before.values) / move.piece;
    if (ratio > 0.0f) {
      plan->feed_rate *= ratio; /* the planner's lengths are those of the motors */
      plan->rate_multiplier = 1.0f / ratio;
    }
  }
  memcpy(&move.motors_before, &move.motors, sizeof(coord_data_t));
  return &move.motors;
}

static uint_fast8_t limits_get_axis_mask(uint_fast8_t axis)
{
  return (uint_fast8_t)bit(axis);
}

static void limits_set_target_pos(uint_fast8_t axis)
{
  sys.position[axis] = 0;
}

/* Motors that have found their switches are where they are at home of the robot. */
static void at_switches(axes_signals_t cycle)
{
  static const double at_home[MOTORS] = {@HOME@}; /* mm, degrees */
  uint_fast8_t k;
  for (k = 0; k < N_AXIS; k++)
    if (bit_istrue(cycle.mask, bit(k))) {
      sys.home_position[k] = k < MOTORS ? (float)at_home[k] : 0.0f;
      sys.position[k] = (int32_t)lroundf(sys.home_position[k] * settings.axis[k].steps_per_mm);
    }
  @NAME@_start(&@NAME@_@MODEL@, &state);
  @NAME@_start(&@NAME@_@MODEL@, &measured);
}

static float homing_cycle_get_feedrate(axes_signals_t axes, float rate, homing_mode_t mode)
{
  (void)axes;
  (void)mode;
  homing = true;
  return rate;
}

static void homing_is_completed(axes_signals_t cycle, bool success)
{
  homing = false;
  if (on_homing_completed)
    on_homing_completed(cycle, success);
}

static void jog_is_cancelled(sys_state_t now)
{
  stopped = true;
  if (on_jog_cancel)
    on_jog_cancel(now);
}

static void report_options(bool newopt)
{
  if (on_report_options)
    on_report_options(newopt);
  if (!newopt)
    hal.stream.write("[KINEMATICS:@NAME@]" ASCII_EOL);
}

/* Called by grblHAL at its start, as every plugin. */
void my_plugin_init(void)
{
  double worst;
  if (@NAME@_selftest(&@NAME@_@MODEL@, &worst) != 0) {
    system_raise_alarm(Alarm_SelftestFailed);
    return;
  }
  @NAME@_start(&@NAME@_@MODEL@, &state);
  @NAME@_start(&@NAME@_@MODEL@, &measured);
  kinematics.transform_from_cartesian = from_cartesian;
  kinematics.transform_steps_to_cartesian = steps_to_cartesian;
  kinematics.segment_line = segment_line;
  kinematics.limits_get_axis_mask = limits_get_axis_mask;
  kinematics.limits_set_target_pos = limits_set_target_pos;
  kinematics.limits_set_machine_positions = at_switches;
  kinematics.homing_cycle_get_feedrate = homing_cycle_get_feedrate;
  on_jog_cancel = grbl.on_jog_cancel;
  grbl.on_jog_cancel = jog_is_cancelled;
  on_homing_completed = grbl.on_homing_completed;
  grbl.on_homing_completed = homing_is_completed;
  on_report_options = grbl.on_report_options;
  grbl.on_report_options = report_options;
}
"""


def _source(machine: Machine) -> str:
    robot, name = machine.robot, machine.name
    at_home = robot.at([robot.home.q]).commands[0] * machine.joint_shown
    texts = {
        "NAME": name,
        "UPPER": name.upper(),
        "MODEL": "calibrated" if "calibrated" in machine.controller.models else "nominal",
        "AXES": str(_axis_count(machine)),
        "AXIS_OF": ", ".join(str(AXIS_INDICES[letter]) for letter in machine.axes.letters),
        "AXIS_UNITS": ", ".join(repr(1.0 / shown) for shown in machine.shown.tolist()),
        "MOTOR_UNITS": ", ".join(repr(1.0 / shown) for shown in machine.joint_shown.tolist()),
        "PIECES": ", ".join(f"{share:.6g}" for share in _move_scale(machine)),
        "CHORD": f"{1e6 * _CHORD:g} um or urad",
        "HOME": ", ".join(repr(value) for value in at_home.tolist()),
    }
    return fill(_SOURCE, texts, {"ROBOT": robot.name})


def _readme(machine: Machine) -> str:
    robot, name = machine.robot, machine.name
    used = {letter: c.name for letter, c in zip(machine.axes.letters, robot.coordinates, strict=True)}
    axes = ", ".join(f"{letter}: {markdown(of)}" for letter, of in used.items())
    motors = ", ".join(
        f"{k}: {markdown(c.name)} [{'mm' if c.unit == 'm' else 'deg'}]" for k, c in enumerate(robot.command_coordinates)
    )
    return f"""# {markdown(robot.name)} in grblHAL

Written for the interface of grblHAL's core of August 2026, and compiled against its headers; not run on a controller.

Axes: {axes}; millimetres and degrees, angles of R = Rx(A) Ry(B) Rz(C).
Motors, in the controller's order: {motors}. Axes that the robot does not have are motors of their own after these.

- Put `{name}_grblhal.c`, `{name}.h` and `{name}_parameters.h` beside `grbl.h`, define `KINEMATICS_API` in `config.h`,
  and build with `N_AXIS` of at least {_axis_count(machine)}. The file is a plugin (`my_plugin_init`).
- Steps per mm of `$100` and on, rates and accelerations are those of the motors, per mm or degree.
- Moves are divided so that motors are off by at most {1e6 * _CHORD:g} um or urad between two poses. A move of which any
  part breaks a limit is not begun: alarm 2.
- Homing moves the motors one by one; at their switches they are where the robot is at home.
- At the start a self-test compares with poses computed by Pinocchio; if it fails the controller stays in alarm.
- `check_motors.csv` has the motors at poses, computed by Pinocchio.
- `{name}_grblhal.c` includes headers under the GPL and is under the GPL, version 3 or later; the other two are not.
"""
