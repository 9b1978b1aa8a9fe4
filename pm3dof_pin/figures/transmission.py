"""Transmissions of joints driven through loops, over two joints: polytopes, apparent inertia, torques, drives."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from pm3dof_pin.capability.polytopes import Polytopes
from pm3dof_pin.capability.transmission import Transmission
from pm3dof_pin.figures.color_scale import color_scale
from pm3dof_pin.figures.labels import axis_label, drawn, in_words, plain
from pm3dof_pin.figures.outlined_mesh import draw_map, outlined_mesh
from pm3dof_pin.figures.style import COLORMAP, TWO_COLUMNS, house_style, new_figure, round_ticks
from pm3dof_pin.typing import Array, Mask

_GRID = 5  # polytopes along each joint
_LINES = 5  # of constant second joint
_COLUMNS = 3  # drives side by side


def transmission_pictures(box: Transmission) -> dict[str, Figure]:
    """Draw a transmission over a grid of joints, by name: over two of them, the others in the middle of their ranges.

    `torque_polytopes`, `speed_polytopes`, `joint_maps` (apparent inertia and greatest pure torque) and `drive_angles`;
    for a single joint, and where limits are unknown, those that can be drawn. Torques without known efforts are in
    multiples of the drives' efforts.
    """
    figures = {"drive_angles": _drive_angles(box)}
    if len(box.joints) > 1:
        figures["joint_maps"] = _joint_maps(box)
    if len(box.joints) == 2:
        known = bool(np.isfinite(box.effort).all())
        unit = _units(box, "N m", "N") if known else "drive efforts"
        torques = box.torques if known else box.unit_torques
        figures["torque_polytopes"] = _polytopes(box, torques, "Torques beyond those that hold the weight", unit)
        if np.isfinite(box.speed).all():
            figures["speed_polytopes"] = _polytopes(
                box, box.speeds, "Speeds of the joints", _units(box, "rad/s", "m/s")
            )
    return figures


def _units(box: Transmission, turning: str, sliding: str) -> str:
    """Return the units of a quantity of the first two joints, one if they are the same."""
    found = [sliding if coordinate.unit == "m" else turning for coordinate in box.poses.robot.coordinates[:2]]
    return ", ".join(dict.fromkeys(found))


def _section(box: Transmission, values: Array) -> Array:
    """Return values over the first two joints, shape=(n1, n2, ...); the others are in the middle, NaN beyond limits."""
    shape = box.poses.shape
    within = box.poses.within_limits.reshape(*shape, *(1,) * (values.ndim - len(shape)))
    middle = tuple(size // 2 for size in shape[2:])
    index: Any = (slice(None), slice(None), *middle)
    return np.asarray(np.where(within, values, np.nan)[index])


def _axes(box: Transmission) -> list[tuple[Array, str]]:
    """Return values and label of the first joints."""
    return [
        (drawn(values, coordinate.unit), axis_label(coordinate.name, coordinate.unit))
        for values, coordinate in zip(box.axes[:2], box.poses.robot.coordinates[:2], strict=True)
    ]


def _title(figure: Figure, box: Transmission, words: str, height: float) -> None:
    held = [
        in_words(coordinate.name, float(axis[len(axis) // 2]), coordinate.unit, 3)
        for axis, coordinate in zip(box.axes[2:], box.poses.robot.coordinates[2:], strict=True)
    ]
    where = f", at {', '.join(held)}" if held else ""
    figure.suptitle(f"{words}: {plain(box.poses.robot.name)}{where}", y=1.0 - 0.06 / height, va="top")


def _polytopes(box: Transmission, polytopes: Polytopes, words: str, unit: str) -> Figure:
    """Draw polytopes at a grid of poses, each about its pose, all in one scale, coloured by the greatest circle."""
    (first, across), (second, up) = _axes(box)
    within = box.poses.within_limits & np.isfinite(box.jacobian).all(axis=(-2, -1))
    picks = [np.unique(np.linspace(0, len(v) - 1, min(len(v), _GRID)).round().astype(int)) for v in (first, second)]
    chosen = [(int(i), int(j)) for i in picks[0] for j in picks[1] if within[i, j]]
    shapes = {at: points for at in chosen if len(points := polytopes.vertices(at)) > 2}  # else gravity leaves no room
    spans = [np.ptp(first) or 1.0, np.ptp(second) or 1.0]
    steps = [span / max(len(pick) - 1, 1) for span, pick in zip(spans, picks, strict=True)]
    largest = max((float(np.abs(points).max(initial=0.0)) for points in shapes.values()), default=1.0) or 1.0
    half = 0.45 * np.array(steps) / largest
    radii = {at: float(polytopes.ball_radius[at]) for at in shapes}
    height = 4.2
    with house_style():
        figure = new_figure(TWO_COLUMNS, height)
        panel = figure.subplots()
        scale = Normalize(min(radii.values(), default=0.0), max(radii.values(), default=1.0))
        for at, points in shapes.items():
            place = np.array([first[at[0]], second[at[1]]])
            colour = colormaps[COLORMAP](scale(radii[at]))
            panel.add_patch(Polygon(place + _around(points) * half, facecolor=colour, edgecolor="#222222", alpha=0.85))
            panel.plot(*place, "+", color="white", markersize=4.0)
        panel.set_xlim(first[0] - 0.6 * steps[0], first[-1] + 0.6 * steps[0])
        panel.set_ylim(second[0] - 0.6 * steps[1], second[-1] + 0.6 * steps[1])
        panel.set_xlabel(across)
        panel.set_ylabel(up)
        round_ticks(panel)
        bar = figure.colorbar(ScalarMappable(scale, COLORMAP), ax=panel, pad=0.02)
        bar.set_label(f"greatest circle inside [{unit}]")
        _title(figure, box, words, height)
        ends = ", ".join(plain(joint) for joint in box.joints)
        panel.set_title(f"each about its pose, in axes {ends}; neighbours are {2 / 0.9 * largest:.3g} {unit} apart")
        figure.subplots_adjust(left=0.09, right=0.98, top=1.0 - 0.5 / height, bottom=0.45 / height)
    return figure


def _around(points: Array) -> Array:
    """Return vertices of a convex polygon in order around it."""
    away = points - points.mean(axis=0)
    return points[np.argsort(np.arctan2(away[:, 1], away[:, 0]))]


def _joint_maps(box: Transmission) -> Figure:
    """Draw apparent inertia and greatest pure torque of each of the first two joints."""
    (_, across), (_, up) = _axes(box)
    rotors = bool(np.nanmax(np.abs(box.rotor_inertia), initial=0.0) > 0.0)
    inertia = np.einsum("...ii->...i", box.rotor_inertia if rotors else box.inertia)
    known = bool(np.isfinite(box.effort).all())
    torques = box.pure_total_torques if known else box.unit_pure_torques
    slides = [coordinate.unit == "m" for coordinate in box.poses.robot.coordinates[:2]]
    rows = [
        (
            "rotor inertia felt" if rotors else "inertia",
            ["kg" if is_slide else "kg m²" for is_slide in slides],
            inertia,
        ),
        (
            "greatest torque",
            [("N" if is_slide else "N m") if known else "drive efforts" for is_slide in slides],
            torques,
        ),
    ]
    height = 5.0
    with house_style():
        figure = new_figure(TWO_COLUMNS, height)
        panels = figure.subplots(2, 2, sharex=True, sharey=True)
        for row, (words, units, values) in zip(panels, rows, strict=True):
            for k, panel in enumerate(row):
                _map(figure, panel, box, _section(box, values)[..., k], units[k])
                named = words.replace("torque", "force") if slides[k] else words
                panel.set_title(f"{named}, {plain(box.joints[k])}")
        for panel in panels[-1]:
            panel.set_xlabel(across)
        for panel in panels[:, 0]:
            panel.set_ylabel(up)
        _title(figure, box, "Joints driven through loops", height)
        figure.subplots_adjust(left=0.1, right=0.95, top=1.0 - 0.6 / height, bottom=0.45 / height, hspace=0.25)
    return figure


def _map(figure: Figure, panel: Axes, box: Transmission, values: Array, unit: str) -> None:
    """Draw values over the first two joints up to the limits; nothing if there are none."""
    inside = np.isfinite(values)
    if not inside.any():
        panel.set_visible(False)
        return
    robot, middle = box.poses.robot, np.array([axis[len(axis) // 2] for axis in box.axes])

    def within(points: Array) -> Mask:
        rows = np.tile(middle, (len(points), 1))
        rows[:, :2] = points
        return np.asarray(robot.solve(rows, on_failure="nan").within_limits)

    mesh = outlined_mesh(box.axes[0], box.axes[1], inside, within)
    units = [coordinate.unit for coordinate in robot.coordinates[:2]]
    scale = color_scale(values)
    ends = np.nanmin(values), np.nanmax(values)  # the scale's: values are extrapolated up to the limits
    draw_map(panel, mesh, np.clip(mesh.values(values), *ends), scale, units)
    bar = figure.colorbar(ScalarMappable(scale.norm(), COLORMAP), ax=panel, pad=0.03)
    scale.label(bar)
    bar.set_label(unit)
    round_ticks(panel)


def _drive_angles(box: Transmission) -> Figure:
    """Draw each drive's counter reading against the first joint, a line for some values of the second."""
    (first, across), *others = _axes(box)
    commands = box.poses.robot.command_coordinates
    readings: Mapping[str, Array] = {
        command.name: drawn(box.poses.commands[..., k], command.unit) for k, command in enumerate(commands)
    }
    columns = min(len(readings), _COLUMNS)
    rows = -(-len(readings) // columns)
    height = 2.8 * rows
    with house_style():
        figure = new_figure(TWO_COLUMNS, height)
        panels = list(figure.subplots(rows, columns, squeeze=False).ravel())
        for panel in panels[len(readings) :]:
            panel.set_visible(False)
        panels = panels[: len(readings)]
        for panel, command, values in zip(panels, commands, readings.values(), strict=True):
            if not others:
                panel.plot(first, np.where(box.poses.within_limits, values, np.nan))
            else:
                second, label = others[0]
                section = _section(box, values)
                picks = np.unique(np.linspace(0, len(second) - 1, min(len(second), _LINES)).round().astype(int))
                for number, j in enumerate(picks):
                    colour = colormaps[COLORMAP](0.9 * number / max(len(picks) - 1, 1))
                    panel.plot(first, section[:, j], color=colour, label=f"{second[j]:.3g}")
                if panel is panels[columns - 1]:
                    beside = {"loc": "upper left", "bbox_to_anchor": (1.02, 1.0), "borderaxespad": 0.0}
                    panel.legend(title=label, fontsize=6.5, title_fontsize=6.5, **beside)
            panel.set_xlabel(across)
            panel.set_ylabel(axis_label(command.name, command.unit))
            round_ticks(panel, *((5, 7) if columns < _COLUMNS else (3, 5)))
        _title(figure, box, "Drives against joints", height)
        right = 0.84 if others else 0.98
        figure.subplots_adjust(left=0.11, right=right, top=1.0 - 0.4 / height, bottom=0.5 / height, wspace=0.55)
    return figure
