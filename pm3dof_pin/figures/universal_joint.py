"""The passive leg's universal joint on the moving platform or at the base: motion and stiffness side by side."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pm3dof_pin.elastic.batch import evaluate
from pm3dof_pin.elastic.indices import felt_stiffness
from pm3dof_pin.elastic.quantities import AXIS_COMPLIANCE
from pm3dof_pin.figures.labels import entry_words
from pm3dof_pin.figures.style import INK, TWO_COLUMNS, house_style, new_figure
from pm3dof_pin.kinematics.robot import Robot

_COLORS = ("#0072B2", "#D55E00")
_AXES = {0: ("x", 1e6, "N/µm"), 2: ("z", 1e6, "N/µm"), 3: ("rx", 1e3, "kN m/rad"), 5: ("rz", 1e3, "kN m/rad")}
_TILTS = np.radians(np.linspace(-38.0, 38.0, 77))
_DRAWN_TILTS = (-30.0, 0.0, 30.0)
_HALF = 0.075  # half the width of a platform that is drawn [m]


def universal_joint_figure(robots: Mapping[str, Robot], height: float) -> Figure:
    """Draw the passive leg and the felt stiffness of two robots while the platform tilts about y at a height [m]."""
    with house_style():
        figure = new_figure(TWO_COLUMNS, 4.4)
        grid = figure.add_gridspec(
            2, 3, left=0.085, right=0.985, top=0.94, bottom=0.1, wspace=0.32, hspace=0.5, width_ratios=[1.25, 1, 1]
        )
        motions = [figure.add_subplot(grid[row, 0]) for row in (0, 1)]
        panels = [figure.add_subplot(grid[row, column]) for row in (0, 1) for column in (1, 2)]
        for (words, robot), motion, color in zip(robots.items(), motions, _COLORS, strict=True):
            poses = robot.solve(robot.grid(theta_y=(_TILTS[0], _TILTS[-1], len(_TILTS)), z_e=height), on_failure="nan")
            inside = poses.within_limits
            felt = np.full((len(_TILTS), 6), np.nan)
            felt[inside] = felt_stiffness(evaluate(robot, poses[inside], AXIS_COMPLIANCE).values)
            for panel, (axis, (name, size, unit)) in zip(panels, _AXES.items(), strict=True):
                panel.plot(np.degrees(_TILTS), felt[:, axis] / size, color=color)
                panel.set_title(f"felt {entry_words(name)} [{unit}]")
            _draw_motion(motion, robot, height, color)
            motion.set_title(words, color=color)
        for panel in panels:
            panel.set(xlabel=r"$\theta_y$ [deg]", xlim=(-40.0, 40.0), ylim=(0.0, 1.05 * panel.dataLim.y1))
            panel.grid(color="#DDDDDD", linewidth=0.5)
    return figure


def _draw_motion(axes: Axes, robot: Robot, height: float, color: str) -> None:
    """Draw passive leg and platform at some tilts, seen along y, with the universal joint as a dot."""
    clamp = robot.home.frame_placement("M").translation[[0, 2]]
    for tilt in np.radians(_DRAWN_TILTS):
        configuration = robot.solve([0.0, tilt, height]).configuration()
        tool = configuration.frame_placement("O_e")
        joint = configuration.frame_placement("passive_cross").translation[[0, 2]]
        point, along = tool.translation[[0, 2]], _HALF * tool.rotation[[0, 2], 0]
        width = 2.0 if tilt == 0.0 else 1.0
        for ends in ((clamp, point), (point - along, point + along)):
            axes.plot(*(1e3 * np.array(ends)).T, color=color, linewidth=width)
        axes.plot(*(1e3 * point), "o", color="white", markeredgecolor=color, markersize=4.0)
        axes.plot(*(1e3 * joint), "o", color=INK, markersize=5.0, zorder=3)
    axes.axvline(0.0, color=INK, linewidth=0.5, linestyle=(0, (6, 3)), zorder=0)
    axes.set(aspect="equal", xlabel="$x$ [mm]", ylabel="$z$ [mm]", xlim=(-150.0, 150.0), ylim=(365.0, 545.0))
