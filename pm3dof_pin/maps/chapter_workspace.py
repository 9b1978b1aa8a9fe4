"""The tripod's workspace (Fig. 8.2): its limits in closed form, and the printed working ranges next to its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pm3dof_pin.chapter.kinematics import inverse_kinematics
from pm3dof_pin.chapter.limits import LIMIT_NAMES, limit_flags
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.maps.limit_space import Flags, LimitSpace
from pm3dof_pin.maps.workspace import Workspace
from pm3dof_pin.typing import Array

_BOX_TILTS, _BOX_HEIGHTS = 80, 84  # cells of the printed box: 1 deg and 2 mm with the chapter's ranges


@dataclass(frozen=True)
class RangeStatement:
    """One comparison of a printed range with the computed one."""

    subject: str  #: what is compared: z_e, slider_travel, theta_x, theta_y, box, or binding_limits
    printed: tuple[float, ...]  #: the printed numbers, or none [unit]
    computed: tuple[float, ...]  #: the computed numbers; for binding limits, the shares in the order of Limit [unit]
    unit: str  #: "m", "rad" or "1"
    text: str  #: the comparison in words, angles in degrees


def tripod_space(tripod: Tripod) -> LimitSpace:
    """Return theta_x and theta_y, stacked along z_e, with the limits of Table 8.1."""

    def broken(values: Array) -> Flags:
        return limit_flags(tripod, values).astype(np.uint32)

    lowest, highest = tripod.bounds[4:]
    tilt = 1.001 * tripod.parameters.universal_limit  # beyond either angle of the passive leg
    return LimitSpace(
        machine=tripod.parameters.name,
        names=("theta_x", "theta_y", "z_e"),
        units=("rad", "rad", "m"),
        limits=LIMIT_NAMES,
        broken_limits=broken,
        box=np.array([(-tilt, tilt), (-tilt, tilt), (lowest, highest)]),
        start=np.array([0.0, 0.0, tripod.middle_height]),
    )


def printed_ranges(tripod: Tripod) -> Array:
    """Return the printed ranges of theta_x, theta_y and z_e, shape=(3, 2) [rad, rad, m]."""
    p = tripod.parameters
    return np.array([p.tilt_range, p.tilt_range, p.height_range])


def compare_printed_ranges(tripod: Tripod, workspace: Workspace) -> list[RangeStatement]:
    """Compare the chapter's printed ranges of theta_x, theta_y and z_e with a reachable set."""
    return [
        _heights(tripod, workspace),
        _travel_at_printed_heights(tripod),
        _tilts(tripod, workspace, 0),
        _tilts(tripod, workspace, 1),
        _box(tripod, workspace),
        _binding_limits(workspace),
    ]


def _heights(tripod: Tripod, workspace: Workspace) -> RangeStatement:
    printed, computed = tripod.parameters.height_range, workspace.level_range
    shift = 1e3 * (computed - printed)
    text = (
        f"z_e runs from {computed[0]:.4f} to {computed[1]:.4f} m, printed {printed[0]:.3f} to {printed[1]:.3f} m: "
        f"{shift[0]:+.1f} mm at the lower end, {shift[1]:+.1f} mm at the upper"
    )
    return RangeStatement("z_e", _numbers(printed), _numbers(computed), "m", text)


def _travel_at_printed_heights(tripod: Tripod) -> RangeStatement:
    """Slider travel of the level platform at the printed heights, NaN if no travel reaches them."""
    printed = tripod.parameters.height_range
    stops = tripod.bounds[:2]
    poses = np.stack([np.zeros(2), np.zeros(2), printed], axis=-1)
    travel = inverse_kinematics(tripod, poses, on_failure="nan")[:, 0]
    text = (
        f"a level platform at the printed heights needs the sliders at {travel[0]:.4f} and {travel[1]:.4f} m; "
        f"they run from {stops[0]:.4f} to {stops[1]:.4f} m"
    )
    return RangeStatement("slider_travel", _numbers(stops), _numbers(travel), "m", text)


def _tilts(tripod: Tripod, workspace: Workspace, axis: int) -> RangeStatement:
    name = ("theta_x", "theta_y")[axis]
    printed, computed = tripod.parameters.tilt_range, workspace.ranges[axis]
    heights = workspace.range_levels[axis]
    ranges = np.array([section.ranges[axis] for section in workspace.sections if not section.empty])
    both_sides = float(np.minimum(-ranges[:, 0], ranges[:, 1]).max())
    low, high, least, greatest, both = np.degrees([*printed, *computed, both_sides])
    text = (
        f"{name} runs from {least:.1f} deg (at z_e = {heights[0]:.4f} m) to {greatest:.1f} deg "
        f"(at {heights[1]:.4f} m), printed {low:.0f} to {high:.0f} deg; "
        f"to both sides at one height it reaches {both:.1f} deg"
    )
    return RangeStatement(name, _numbers(printed), (*_numbers(computed), both_sides), "rad", text)


def _box(tripod: Tripod, workspace: Workspace) -> RangeStatement:
    """Share of the printed box that is reachable, and share of the reachable set in the box, by counting cells."""
    tilt, height = _numbers(tripod.parameters.tilt_range), _numbers(tripod.parameters.height_range)
    tilts, heights = _cell_centres(tilt[0], tilt[1], _BOX_TILTS), _cell_centres(height[0], height[1], _BOX_HEIGHTS)
    poses = np.stack(np.meshgrid(tilts, tilts, heights, indexing="ij"), axis=-1)
    filled = float(np.mean(limit_flags(tripod, poses) == 0))
    inside = filled * (tilt[1] - tilt[0]) ** 2 * (height[1] - height[0]) / workspace.volume
    text = (
        f"{filled:.1%} of the printed box of theta_x, theta_y and z_e is within all joint limits; "
        f"{inside:.1%} of the reachable set is in the box"
    )
    return RangeStatement("box", (1.0,), (filled, inside), "1", text)


def _cell_centres(first: float, last: float, count: int) -> Array:
    return first + (last - first) * (np.arange(count) + 0.5) / count


def _binding_limits(workspace: Workspace) -> RangeStatement:
    shares = workspace.limit_shares
    binding = ", ".join(f"{limit} {share:.0%}" for limit, share in shares.items() if share > 0.0)
    idle = ", ".join(limit for limit, share in shares.items() if share == 0.0)
    text = f"limits that end the reachable set, by their share of the boundary: {binding}; never: {idle or 'none'}"
    return RangeStatement("binding_limits", (), tuple(shares.values()), "1", text)


def _numbers(values: Array) -> tuple[float, ...]:
    return tuple(map(float, values))
