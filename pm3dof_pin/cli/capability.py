"""`pm3dof capability`."""

from __future__ import annotations

from typing import Any

import numpy as np

from pm3dof_pin.capability.tool_capability import ToolCapability, tool_capability
from pm3dof_pin.cli.drive_options import DriveEffort, DriveSpeed, limits_of_drives
from pm3dof_pin.cli.options import (
    AppliedWrenches,
    Json,
    MachineOptions,
    Payload,
    PoseOptions,
    Twists,
    payloads_of,
)
from pm3dof_pin.cli.output import message, table_lines
from pm3dof_pin.cli.poses import column_of, print_at_pose, solve_chosen
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS, unit_of
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.typing import Array


def capability(
    chosen: PoseOptions,
    which: MachineOptions,
    effort: DriveEffort = None,
    speed: DriveSpeed = None,
    wrench: AppliedWrenches = None,
    twist: Twists = None,
    payload: Payload = 0.0,
    as_json: Json = False,
) -> None:
    """Say how hard the tool can push and how fast it can go at a pose: angles in degrees, lengths in metres.

    Along and about each axis of the base, to either side, with no other load; "-" where nothing limits it, as the
    structure alone carries the load, and "none" where the drives cannot even hold the weight. With --wrench, the share
    of the drives' efforts that these wrenches on the environment leave, and how many times each of them is held; with
    --twist, how many times as fast the tool can move so. Gravity counts. A pose that breaks a joint limit is still
    computed, with a message and exit status 1.
    """
    robot = which.load()
    limits: Any = limits_of_drives(robot, effort=effort, speed=speed) | {"payloads": payloads_of(robot, payload)}
    wrenches, twists = ([list(entry) for entry in entries or ()] for entries in (wrench, twist))

    def columns(poses: Poses) -> dict[str, Array]:
        at = tool_capability(robot, poses, on_failure="nan", **limits)
        found = {column_of(f"force_{name}", "N"): value for name, value in zip("xyz", _forces(at).T[:3], strict=True)}
        if wrenches:
            found["effort_left"] = at.effort_left(wrenches)
        return found

    if (pose := solve_chosen(robot, chosen, columns, as_json)) is None:
        return
    at = tool_capability(robot, pose, **limits)
    result = {"payload_kg": payload, "within_limits": bool(pose.within_limits)} | _result(at, wrenches, twists)
    limits_known = {"--effort": at.effort, "--speed": at.speed}
    if unknown := [name for name, values in limits_known.items() if not np.isfinite(values).all()]:
        message(f"pm3dof: {' and '.join(unknown)}: not described for all drives; results that need them are left out")
    if not result.get("weight_is_held", True):
        message("pm3dof: the drives cannot hold the weight at this pose: no force is left")
    print_at_pose(pose, result, _lines(result), as_json=as_json)


def _forces(at: ToolCapability) -> Array:
    """Return the greatest force or torque along each axis in the weaker direction, shape=(..., 6)."""
    return np.stack([np.minimum(at.greatest_wrench(a), at.greatest_wrench(-a)) for a in np.eye(6)], axis=-1)


def _result(at: ToolCapability, wrenches: list[list[float]], twists: list[list[float]]) -> dict[str, Any]:
    result: dict[str, Any] = {"drives": at.drives}
    if np.isfinite(at.effort).all():
        pushes = {
            sign: [at.greatest_wrench(factor * a) for a in np.eye(6)] for sign, factor in (("+", 1.0), ("-", -1.0))
        }
        result |= {
            "effort": at.effort,
            "weight_is_held": bool(at.effort_left(np.zeros(6)) >= 0.0),
            "greatest_force_N": {sign: values[:3] for sign, values in pushes.items()},
            "greatest_torque_N_m": {sign: values[3:] for sign, values in pushes.items()},
            "force_polytope_N": _forces_at_once(at),
            "force_ellipsoid_N": _ellipsoid(*at.force_ellipsoid()),
        }
    if np.isfinite(at.speed).all():
        speeds = [at.greatest_twist(a) for a in np.eye(6)]
        result |= {"speed": at.speed, "greatest_speed_m_s": speeds[:3], "greatest_speed_rad_s": speeds[3:]}
        result["speed_polytope_m_s"] = _velocities(at)
        result["speed_ellipsoid_m_s"] = _ellipsoid(*at.speed_ellipsoid())
    if wrenches:
        result |= {
            "wrenches": wrenches,
            "effort_left": [float(at.effort_left(entry)) for entry in wrenches],
            "times_held": [float(at.greatest_wrench(entry)) for entry in wrenches],
        }
    if twists:
        result |= {"twists": twists, "times_reached": [float(at.greatest_twist(entry)) for entry in twists]}
    return result


def _forces_at_once(at: ToolCapability) -> Array | None:
    """Return the vertices of the forces without moments; None if they are unbounded."""
    try:
        return at.wrenches.pulled_back(np.eye(6)[:, :3]).vertices()
    except InvalidValueError:
        return None


def _ellipsoid(semi_axes: Array, directions: Array) -> dict[str, Array]:
    return {"semi_axes": semi_axes, "directions": directions.T}


def _velocities(at: ToolCapability) -> Array | None:
    """Return the velocities of the tool's point whose convex hull is the speed polytope; None if they are too many."""
    try:
        return at.velocities(slice(0, 3))
    except InvalidValueError:
        return None


def _lines(result: dict[str, Any]) -> list[str]:
    rows = []
    for k, name in enumerate(TOOL_COMPONENTS):
        is_length = unit_of(name) == "m"
        row: list[str] = [name]
        if "greatest_force_N" in result:
            part = result["greatest_force_N" if is_length else "greatest_torque_N_m"]
            row += [_number(part[sign][k % 3]) for sign in "+-"] + ["N" if is_length else "N m"]
        if "greatest_speed_m_s" in result:
            row += [_number(result["greatest_speed_m_s" if is_length else "greatest_speed_rad_s"][k % 3])]
            row += ["m/s" if is_length else "rad/s"]
        rows.append(row)
    header = [""]
    header += ["push +", "push -", ""] if "greatest_force_N" in result else []
    header += ["speed", ""] if "greatest_speed_m_s" in result else []
    lines = [line.rstrip() for line in table_lines(header, rows)] if len(header) > 1 else []
    for words, key, unit in (("forces", "force_ellipsoid_N", "N"), ("velocities", "speed_ellipsoid_m_s", "m/s")):
        if key in result:
            axes = ", ".join(_number(axis) for axis in result[key]["semi_axes"])
            lines.append(f"ellipsoid of {words} of the drives' limits: semi-axes {axes} {unit}")
    shares = (result.get(key, []) for key in ("wrenches", "effort_left", "times_held"))
    for entry, left, times in zip(*shares, strict=True):
        state = "is held" if left >= 0.0 else "is not held"
        words = f"{100.0 * left:.1f} % of the most loaded drive's effort left, {_times(times)} as much"
        lines.append(f"wrench {_words(entry)} {state}: {words}")
    for entry, times in zip(result.get("twists", []), result.get("times_reached", []), strict=True):
        lines.append(f"twist {_words(entry)}: {_times(times)} as fast")
    return lines


def _words(entry: list[float]) -> str:
    return " ".join(f"{number:g}" for number in entry)


def _number(value: float) -> str:
    if np.isnan(value):
        return "none"
    return f"{float(value):.6g}" if np.isfinite(value) else "-"


def _times(value: float) -> str:
    return "any number of times" if np.isinf(value) else f"at most {value:.4g} times"
