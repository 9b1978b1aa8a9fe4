"""The kinematics module of LinuxCNC."""

from __future__ import annotations

import math

from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.export.machine_axes import AXIS_INDICES, Machine
from pm3dof_pin.export.template import fill

_MEMBERS = {letter: f"tran.{letter.lower()}" if letter in "XYZ" else letter.lower() for letter in "XYZABCUVW"}

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

/* Joint per pose unit; under a tool length by central differences, which end at that of the inverse: 1e-10 or so. */
int kinematicsJacobian(const double *joint, const EmcPose *pos, double jac[EMCMOT_MAX_JOINTS][EMCMOT_MAX_AXIS],
                       const KINEMATICS_INVERSE_FLAGS *iflags)
{
  static const int axis[AXES] = {@AXIS_INDICES@};
  const double step = 1e-3; /* mm, degrees */
  double x[AXES], commands[JOINTS], found[JOINTS][AXES], ends[2][EMCMOT_MAX_JOINTS];
  @NAME@_state state = inverse_state;
  int j, k, side;
  (void)joint;
  get(pos, x);
  for (j = 0; j < EMCMOT_MAX_JOINTS; j++)
    for (k = 0; k < EMCMOT_MAX_AXIS; k++)
      jac[j][k] = 0.0;
  if (*pins->tool_offset != 0.0) {
    for (k = 0; k < AXES; k++) {
      for (side = 0; side < 2; side++) {
        EmcPose near = *pos;
        double there[AXES];
        KINEMATICS_FORWARD_FLAGS flags = 0;
        for (j = 0; j < AXES; j++)
          there[j] = x[j] + (j == k ? (side ? step : -step) * axis_unit[k] : 0.0);
        put(there, &near);
        if (kinematicsInverse(&near, ends[side], iflags, &flags) != 0)
          return -1;
      }
      for (j = 0; j < JOINTS; j++)
        jac[j][axis[k]] = (ends[1][j] - ends[0][j]) / (2.0 * step);
    }
    inverse_state = state;
    return 0;
  }
  if (@NAME@_inverse(model(), &state, x, commands) != @UPPER@_OK ||
      @NAME@_jacobian(model(), &state, found) != @UPPER@_OK)
    return -1;
  for (j = 0; j < JOINTS; j++)
    for (k = 0; k < AXES; k++)
      jac[j][axis[k]] = found[j][k] * axis_unit[k] / joint_unit[j];
  return 0;
}

/* Axes of the tool in the base: those of the base at home, where z points from the tip to the holder. */
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


def linuxcnc_module(machine: Machine, module: str) -> str:
    """Return the source of a module of this name."""
    robot, name, axes = machine.robot, machine.name, machine.axes
    pairs = list(zip(axes.letters, range(len(axes.letters)), strict=True))
    moved = [(k, place) for k, place in enumerate(axes.positions) if place is not None]
    has_tool, is_calibrated = robot.tool_frame is not None, "calibrated" in machine.controller.models
    shift, frame = ["  (void)state;"], ["  (void)joint;", "  (void)rot;", "  (void)fflags;", "  return -1;"]
    if has_tool:
        at_home = robot.home.tool_placement.rotation

        def turned(i: int, j: int) -> str:
            terms = [f"T[{i}][{k}] * {float(at_home[j, k])!r}" for k in range(3) if at_home[j, k] != 0.0]
            return " + ".join(term.removesuffix(" * 1.0") for term in terms)

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
            *(f"rot->{'xyz'[j]}.{'xyz'[i]} = {turned(i, j)};" for j in range(3) for i in range(3)),
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
        "AXIS_INDICES": ", ".join(str(AXIS_INDICES[letter]) for letter in axes.letters),
        "SWITCH": f"*pins->calibrated ? &{name}_calibrated : &{name}_nominal" if is_calibrated else f"&{name}_nominal",
        "HAS_CALIBRATED": str(int(is_calibrated)),
        "UPPER": name.upper(),
        "MODULE": module,
        "NAME": name,
    }
    return fill(_MODULE, texts, {"ROBOT": robot.name})


def _unit(coordinate: Coordinate) -> str:
    return "1e-3" if coordinate.unit == "m" else repr(math.pi / 180.0)
