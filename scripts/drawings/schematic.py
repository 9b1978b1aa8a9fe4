"""Labelled schematic of the tripod, drawn from its own numbers: points, frames, angles and lengths (Fig. 8.1b)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Arc, Circle, Patch, Polygon
from matplotlib.patheffects import withStroke

from pm3dof_pin.chapter.kinematics import Legs, placement
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.exceptions import UnreachablePoseError
from pm3dof_pin.figures.style import INK, TWO_COLUMNS, house_style, new_figure, towards_viewer
from pm3dof_pin.typing import Array

_ELEVATION, _AZIMUTH = 21.0, -52.0  # viewing direction [deg]
_GUIDE, _SLIDER, _LINK, _PASSIVE, _PLATFORM = "#555555", "#D55E00", "#0072B2", "#007F5F", "#B8860B"
_LIGHT = {"base": "#ECECEC", "middle": "#D9D9D9", "platform": "#FBE7B2"}
_FILL, _DIMENSION = "#F6C9A8", "#777777"
_SLIDER_SIZE = np.array([0.024, 0.012])  # half length and half width of a drawn slider [m]


def schematic_figure(tripod: Tripod) -> Figure:
    """Draw the machine in its home pose with the names of its points, frames, angles and lengths.

    Four views: the whole machine in orthographic projection, its base and its moving platform from above, and one leg
    in the vertical plane of its guideway.

    Raises:
        UnreachablePoseError: the guideways do not rise to the height of the middle platform.
    """
    points = _Points(tripod)
    with house_style():
        figure = new_figure(TWO_COLUMNS, 4.75)
        _draw_machine(_panel(figure, (0.005, 0.07, 0.515, 0.92)), points)
        _draw_base(_panel(figure, (0.505, 0.545, 0.225, 0.39), "Base platform from above"), points)
        _draw_platform(_panel(figure, (0.745, 0.545, 0.225, 0.39), "Moving platform from above"), points)
        _draw_leg(_panel(figure, (0.53, 0.02, 0.46, 0.49), "One leg in the plane of its guideway"), points)
        _add_legend(figure)
    return figure


class _Points:
    """Named points of the machine at home, base frame [m]; at `middle` the guideways reach the height of the clamp."""

    def __init__(self, tripod: Tripod) -> None:
        self.tripod = tripod
        pose = tripod.home
        legs = Legs.at(tripod, pose)
        transform = placement(tripod.home)
        rise = tripod.guide_directions[:, 2]
        if np.any(rise <= 0.0):
            raise UnreachablePoseError("the guideways do not rise to the middle platform: there is no M_i to draw")
        self.origin = np.zeros(3)
        self.tool = transform[:3, 3]
        self.rotation = transform[:3, :3]
        self.clamp = np.array([0.0, 0.0, tripod.clamp_height])
        self.base = tripod.base_joints
        self.middle = self.base + (tripod.clamp_height / rise)[:, None] * tripod.guide_directions
        self.slider = self.base + legs.travels[:, None] * tripod.guide_directions
        self.ball = self.tool + legs.arms


def _panel(figure: Figure, place: tuple[float, float, float, float], title: str = "") -> Axes:
    axes = figure.add_axes(place)
    axes.set_aspect("equal")
    axes.axis("off")
    axes.set_anchor("N")
    axes.set_title(title, fontsize=7.5, pad=9.0)
    return axes


# --- marks -----------------------------------------------------------------------------------------------------------


def _line(axes: Axes, start: Array, end: Array, color: str, width: float, order: float, **style: Any) -> None:
    """Draw a line with a white rim, so that it appears in front of the lines it crosses."""
    rim = [withStroke(linewidth=width + 2.4, foreground="white")] if width > 1.0 else []
    axes.plot(
        *np.stack([start, end], axis=1), color=color, linewidth=width, zorder=order, path_effects=rim,
        solid_capstyle="butt", **style,
    )  # fmt: skip


def _arrow(axes: Axes, start: Array, end: Array, color: str = INK, order: float = 30.0, style: str = "-|>") -> None:
    properties = {
        "arrowstyle": style, "color": color, "linewidth": 0.9, "shrinkA": 0.0, "shrinkB": 0.0, "mutation_scale": 8.0,
    }  # fmt: skip
    axes.update_datalim([tuple(start), tuple(end)])
    axes.annotate("", xy=tuple(end), xytext=tuple(start), arrowprops=properties, zorder=order)


def _label(axes: Axes, point: Array, text: str, away: Sequence[float] | Array, color: str = INK) -> None:
    """Write next to a point, `away` from it [typographic points]."""
    axes.annotate(
        text, xy=tuple(point), xytext=tuple(away), textcoords="offset points", color=color, ha="center", va="center",
        zorder=40, fontsize=7.5, path_effects=[withStroke(linewidth=2.2, foreground="white")],
    )  # fmt: skip


def _spherical(axes: Axes, point: Array, order: float = 26.0) -> None:
    axes.plot(*point, "o", markersize=6.0, markerfacecolor="white", markeredgecolor=INK, zorder=order)


def _universal(axes: Axes, point: Array, order: float = 26.0) -> None:
    _spherical(axes, point, order)
    axes.plot(*point, "x", markersize=4.0, color=INK, markeredgewidth=0.8, zorder=order + 0.1)


def _slider(axes: Axes, point: Array, along: Array, order: float) -> None:
    along = along / np.linalg.norm(along)
    across = np.array([-along[1], along[0]])
    corners = [point + a * _SLIDER_SIZE[0] * along + b * _SLIDER_SIZE[1] * across for a, b in _CORNERS]
    axes.add_patch(Polygon(corners, facecolor=_FILL, edgecolor=_SLIDER, linewidth=1.0, zorder=order))


_ARCS = ((0, 0.45), (1, 0.36), (2, 0.27))  # legs and the radii of the arcs of their angles, over the radius
_CORNERS = ((-1, -1), (1, -1), (1, 1), (-1, 1))


def _dimension(axes: Axes, start: Array, end: Array, text: str, away: tuple[float, float]) -> None:
    _arrow(axes, start, end, _DIMENSION, style="<|-|>")
    _label(axes, 0.5 * (np.asarray(start) + np.asarray(end)), text, away)


def _extension(axes: Axes, start: Array, end: Array) -> None:
    axes.plot(*np.stack([start, end], axis=1), color=_DIMENSION, linewidth=0.5, zorder=1)


def _angle(axes: Axes, centre: Array, radius: float, first: float, last: float, text: str) -> None:
    """Draw an arc between two directions [rad], an arrow head at the last, and its name outside of the middle."""
    low, high = sorted((first, last))
    axes.add_patch(
        Arc(tuple(centre), 2 * radius, 2 * radius, theta1=np.degrees(low), theta2=np.degrees(high), color=_DIMENSION)
    )
    tip = centre + radius * _unit(last)
    back = centre + radius * _unit(last - np.sign(last - first) * min(0.25, 0.6 * abs(last - first)))
    _arrow(axes, back, tip, _DIMENSION)
    middle = _unit(0.5 * (first + last))
    _label(axes, centre + radius * middle, text, 9.0 * middle)


def _unit(angle: float) -> Array:
    return np.array([np.cos(angle), np.sin(angle)])


# --- the four views --------------------------------------------------------------------------------------------------


def _draw_machine(axes: Axes, points: _Points) -> None:
    view = _projection()
    flat = {name: getattr(points, name) @ view for name in ("base", "middle", "slider", "ball")}
    origin, tool, clamp = (point @ view for point in (points.origin, points.tool, points.clamp))
    depth = points.base @ towards_viewer(_ELEVATION, _AZIMUTH)
    order = 10.0 + np.argsort(np.argsort(depth))  # legs at the back are drawn first
    for name, kind, rank in (("base", "base", 1), ("middle", "middle", 12.5), ("ball", "platform", 20)):
        color = {"base": _GUIDE, "middle": _GUIDE, "platform": _PLATFORM}[kind]
        axes.add_patch(Polygon(flat[name], facecolor=_LIGHT[kind], edgecolor=color, linewidth=1.0, zorder=rank))
    _line(axes, clamp, tool, _PASSIVE, 2.6, 19)
    below = (points.clamp - [0.0, 0.0, 0.025]) @ view
    _line(axes, below, clamp, _PASSIVE, 2.6, 8)
    for leg, rank in enumerate(order):
        base, middle, slider, ball = (flat[name][leg] for name in ("base", "middle", "slider", "ball"))
        _line(axes, base, middle, _GUIDE, 2.0, rank)
        _slider(axes, slider, middle - base, rank + 0.1)
        _line(axes, slider, ball, _LINK, 2.2, rank + 8 if depth[leg] > 0 else rank + 1)
        _universal(axes, slider, rank + 9 if depth[leg] > 0 else rank + 2)
        _spherical(axes, ball)
    _universal(axes, tool)
    _name_points(axes, points, flat)
    _label(axes, tool, r"$O_e,\ P$", (-20, -9))
    frame = points.rotation * [0.17, 0.17, 0.1]
    _frame(axes, origin, (0.1 * np.eye(3)) @ view, "b", ((8, -2), (8, 3), (-9, 2)))
    _frame(axes, tool, frame.T @ view, "e", ((9, -2), (9, 3), (-10, 2)))
    _turns(axes, points, view)
    _label(axes, origin, "$O_b$", (-11, -6))
    axes.autoscale_view()
    axes.margins(0.08)


def _name_points(axes: Axes, points: _Points, flat: dict[str, Array]) -> None:
    away = points.base @ _projection()
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    depth = points.base @ towards_viewer(_ELEVATION, _AZIMUTH)
    centres = 0.5 * (flat["slider"] + flat["ball"])
    for leg, out in enumerate(away):
        _label(axes, flat["base"][leg], f"$B_{leg + 1}$", 13 * out)
        side = np.array([np.sign(out[0]) or 1.0, 0.0])
        _label(axes, flat["slider"][leg], f"$D_{leg + 1}$", 17 * side + [0, 3])
        front = leg == int(depth.argmax())
        _label(axes, flat["middle"][leg], f"$M_{leg + 1}$", [-6, -15] if front else 13 * side - [0, 4])
        _label(axes, flat["ball"][leg], f"$E_{leg + 1}$", [14, -12] if front else 13 * side + [0, 6])
        axes.plot(*centres[leg], "o", markersize=2.6, color=_LINK, zorder=30)
        _label(axes, centres[leg], f"$F_{leg + 1}$", 12 * side)


def _projection() -> Array:
    """Axes of the picture as columns, base frame, shape=(3, 2)."""
    eye = towards_viewer(_ELEVATION, _AZIMUTH)
    right = np.array([-np.sin(np.radians(_AZIMUTH)), np.cos(np.radians(_AZIMUTH)), 0.0])
    return np.stack([right, np.cross(eye, right)], axis=1)


def _frame(axes: Axes, at: Array, ends: Array, index: str, away: tuple[tuple[float, float], ...]) -> None:
    for name, end, shift in zip("xyz", ends, away, strict=True):
        _arrow(axes, at, at + end)
        _label(axes, at + end, rf"$\mathbf{{{name}}}_{index}$", shift)


def _turns(axes: Axes, points: _Points, view: Array) -> None:
    """Arrows about x_e and y_e: the two tilts."""
    for axis, name in enumerate("xy"):
        around = np.roll(np.eye(3), -axis - 1, axis=0)[:2]  # y, z about x; z, x about y
        turn = np.linspace(-0.6, 4.0, 60)
        ring = points.tool + 0.132 * np.eye(3)[axis] + 0.018 * np.stack([np.cos(turn), np.sin(turn)], axis=1) @ around
        flat = (points.tool + (ring - points.tool) @ points.rotation.T) @ view
        axes.plot(*flat.T, color=_PLATFORM, linewidth=1.0, zorder=31)
        _arrow(axes, flat[-4], flat[-1], _PLATFORM, 31)
        _label(axes, np.array([flat[:, 0].mean(), flat[:, 1].max()]), rf"$\theta_{name}$", (0, 8), _PLATFORM)


def _draw_base(axes: Axes, points: _Points) -> None:
    p = points.tripod.parameters
    base, middle = points.base[:, :2], points.middle[:, :2]
    axes.add_patch(
        Circle((0, 0), p.base_radius, fill=False, edgecolor=_DIMENSION, linewidth=0.5, linestyle=(0, (5, 3)))
    )
    axes.add_patch(Polygon(base, facecolor=_LIGHT["base"], edgecolor=_GUIDE, linewidth=1.0))
    axes.add_patch(Polygon(middle, facecolor=_LIGHT["middle"], edgecolor=_GUIDE, linewidth=0.8, zorder=3))
    for leg, (foot, top) in enumerate(zip(base, middle, strict=True)):
        out = foot / np.linalg.norm(foot)
        _line(axes, foot, top, _GUIDE, 1.6, 4)
        _slider(axes, points.slider[leg, :2], top - foot, 5)
        axes.plot(*foot, "o", markersize=3.0, color=INK, zorder=6)
        _label(axes, foot, f"$B_{leg + 1}$", 13 * _beside(out))
    _plan_axes(axes, 1.28 * p.base_radius, "b")
    for leg, reach in _ARCS:
        name = rf"$\alpha_{leg + 1}$"
        _angle(axes, np.zeros(2), reach * p.base_radius, 0.0, float(p.base_joint_angles[leg]), name)
    _radius(axes, p.base_radius, "$l_b$")


def _draw_platform(axes: Axes, points: _Points) -> None:
    p = points.tripod.parameters
    ball = points.tripod.platform_joints[:, :2]
    radius = p.platform_radius
    axes.add_patch(Circle((0, 0), radius, fill=False, edgecolor=_DIMENSION, linewidth=0.5, linestyle=(0, (5, 3))))
    axes.add_patch(Polygon(ball, facecolor=_LIGHT["platform"], edgecolor=_PLATFORM, linewidth=1.0))
    for leg, point in enumerate(ball):
        axes.plot(*np.stack([np.zeros(2), point], axis=1), color=_DIMENSION, linewidth=0.6, zorder=2)
        _spherical(axes, point)
        _label(axes, point, f"$E_{leg + 1}$", 15 * _beside(point / radius))
    _universal(axes, np.zeros(2))
    _plan_axes(axes, 1.28 * radius, "e")
    for leg, reach in _ARCS:
        _angle(axes, np.zeros(2), reach * radius, 0.0, float(p.platform_joint_angles[leg]), rf"$\beta_{leg + 1}$")
    _radius(axes, radius, "$l_e$")


def _beside(outward: Array) -> Array:
    """Turn a direction by 40 degrees, clear of an axis of the frame that may lie along it."""
    return np.array([[_unit(-0.7)[0], -_unit(-0.7)[1]], [_unit(-0.7)[1], _unit(-0.7)[0]]]) @ outward


def _plan_axes(axes: Axes, length: float, index: str) -> None:
    for name, direction, away in (("x", (1.0, 0.0), (10, 0)), ("y", (0.0, 1.0), (-10, 2))):
        end = length * np.array(direction)
        _arrow(axes, np.zeros(2), end)
        _label(axes, end, rf"$\mathbf{{{name}}}_{index}$", away)
    _label(axes, np.zeros(2), f"$O_{index}$", (-9, 11))


def _radius(axes: Axes, length: float, name: str) -> None:
    direction = _unit(np.radians(165.0))
    _arrow(axes, np.zeros(2), length * direction, _DIMENSION)
    _label(axes, 0.77 * length * direction, name, (1, 8))
    axes.margins(0.06)


def _draw_leg(axes: Axes, points: _Points) -> None:
    p = points.tripod.parameters
    outward = points.base[0] / np.linalg.norm(points.base[0])
    plane = np.stack([outward, [0.0, 0.0, 1.0]], axis=1)
    base, middle, slider, ball = (
        named[0] @ plane for named in (points.base, points.middle, points.slider, points.ball)
    )
    tool, clamp = points.tool @ plane, points.clamp @ plane
    guide = (middle - base) / np.linalg.norm(middle - base)
    normal = np.array([guide[1], -guide[0]])  # up and outwards
    axes.plot([-0.16, p.base_radius + 0.06], [0, 0], color=_GUIDE, linewidth=1.0, zorder=2)
    _line(axes, clamp * [0, 1] - middle * [1, 0], middle, _GUIDE, 2.0, 3)
    _line(axes, base, middle, _GUIDE, 2.0, 4)
    _slider(axes, slider, guide, 5)
    _line(axes, slider, ball, _LINK, 2.2, 8)
    _line(axes, clamp - np.array([0.0, 0.06]), tool, _PASSIVE, 2.6, 6)
    _line(axes, tool, tool * [1, 0] + ball * [0, 1], _PLATFORM, 1.4, 7)
    _line(axes, ball * [-1, 1], ball, _PLATFORM, 2.0, 7)
    _universal(axes, slider)
    _universal(axes, tool)
    _spherical(axes, ball)
    _label(axes, np.zeros(2), "$O_b$", (-12, 8))
    _arrow(axes, np.zeros(2), np.array([0.0, 0.13]))
    _label(axes, np.array([0.0, 0.13]), r"$\mathbf{z}_b$", (-10, 0))
    _label(axes, base, "$B_i$", (11, 8))
    _label(axes, middle, "$M_i$", (-1, -12))
    _label(axes, slider, "$D_i$", (-13, -7))
    _label(axes, ball, "$E_i$", (13, 5))
    _label(axes, tool, r"$O_e,\ P$", (-20, -10))
    _label(axes, 0.5 * (slider + ball), "$l$", (9, 4))
    _angle(axes, base, 0.085, np.pi, np.pi - float(np.arctan2(guide[1], -guide[0])), r"$\gamma$")
    for end in (base, slider):
        _extension(axes, end, end + 0.075 * normal)
    _dimension(axes, base + 0.065 * normal, slider + 0.065 * normal, "$u_i$", (9, 5))
    low = np.array([0.0, -0.05])
    for end in (np.zeros(2), base):
        _extension(axes, end, end + 1.2 * low)
    _dimension(axes, low, base + low, "$l_b$", (0, -9))
    high = ball[1] + 0.05
    for x in (0.0, ball[0]):
        _extension(axes, np.array([x, ball[1]]), np.array([x, high + 0.01]))
    _dimension(axes, np.array([0.0, high]), np.array([ball[0], high]), "$l_e$", (0, 9))
    _heights(axes, tool, ball, clamp, middle)
    axes.margins(0.06)


def _heights(axes: Axes, tool: Array, ball: Array, clamp: Array, middle: Array) -> None:
    """Dimensions of z_e, z_b and z_0, left of the machine."""
    left, far = -0.1, -0.16
    _extension(axes, tool, np.array([far - 0.01, tool[1]]))
    _extension(axes, clamp - [middle[0], 0], np.array([left - 0.01, clamp[1]]))
    _extension(axes, np.array([-ball[0], ball[1]]), np.array([far - 0.01, ball[1]]))
    _dimension(axes, np.array([left, 0.0]), np.array([left, clamp[1]]), "$z_b$", (10, 0))
    _dimension(axes, np.array([far, 0.0]), np.array([far, tool[1]]), "$z_e$", (-10, 0))
    for start, end in ((tool[1] - 0.035, tool[1]), (ball[1] + 0.035, ball[1])):
        _arrow(axes, np.array([far, start]), np.array([far, end]), _DIMENSION)
    _label(axes, np.array([far, ball[1] + 0.03]), "$z_0$", (-10, 0))


def _add_legend(figure: Figure) -> None:
    joint: dict[str, Any] = {"marker": "o", "markersize": 6.0, "markerfacecolor": "white", "markeredgecolor": INK}
    cross = Line2D([], [], marker="x", markersize=4.0, color=INK, linestyle="none")
    entries: dict[str, Any] = {
        "base platform": Patch(facecolor=_LIGHT["base"], edgecolor=_GUIDE),
        "middle platform": Patch(facecolor=_LIGHT["middle"], edgecolor=_GUIDE),
        "moving platform": Patch(facecolor=_LIGHT["platform"], edgecolor=_PLATFORM),
        "guideway": Line2D([], [], color=_GUIDE, linewidth=2.0),
        "slider, driven": Line2D([], [], marker="s", markerfacecolor=_FILL, markeredgecolor=_SLIDER, linestyle="none"),
        "link": Line2D([], [], color=_LINK, linewidth=2.2),
        "passive leg, sliding": Line2D([], [], color=_PASSIVE, linewidth=2.6),
        "universal joint": (Line2D([], [], linestyle="none", **joint), cross),
        "spherical joint": Line2D([], [], linestyle="none", **joint),
    }
    letters = {"fontsize": 7.0, "handletextpad": 0.5, "columnspacing": 1.2}
    figure.legend(list(entries.values()), list(entries), loc="lower left", ncols=3, **letters)
