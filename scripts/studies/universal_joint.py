"""The passive leg's universal joint on the platform or at the base: a printed table and a picture."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import pm3dof_pin as pm
from pm3dof_pin.elastic.batch import evaluate
from pm3dof_pin.elastic.quantities import AXIS_STIFFNESS
from pm3dof_pin.export.description import temporary_description
from pm3dof_pin.figures.labels import entry_words
from pm3dof_pin.figures.style import FORMATS, INK, TWO_COLUMNS, house_style, new_figure, save_pictures
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps.quantity import MappedRobot
from pm3dof_pin.maps.workspace_evaluation import evaluate_workspace

RESULTS = Path(__file__).resolve().parents[2] / "results"
POINTS = 31
COLORS = ("#0072B2", "#D55E00")
AXES = {0: ("x", 1e6, "N/µm"), 2: ("z", 1e6, "N/µm"), 3: ("rx", 1e3, "kN m/rad"), 5: ("rz", 1e3, "kN m/rad")}
TILTS = np.radians(np.linspace(-38.0, 38.0, 77))
DRAWN_TILTS = (-30.0, 0.0, 30.0)
HALF = 0.075  # half the width of a platform that is drawn [m]


def main(out: Path = RESULTS, points: int = POINTS, formats: Sequence[str] = FORMATS) -> None:
    robots = {
        "universal joint on the platform": pm.load("pm3dof"),
        "universal joint at the base": pm.load(temporary_description("pm3dof", "universal_joint_at_base")),
    }
    print(*save_pictures(universal_joint_figure(robots, 0.487333), out / "universal_joint", formats), sep="\n")
    print(f"\n{'mean over the workspace':32}" + "".join(f"{axis:>12}" for axis in ("x", "y", "z", "rx", "ry", "rz")))
    for words, robot in robots.items():
        grid = robot.grid(**{c.name: (*robot.range_of(c), points) for c in robot.coordinates})
        found = evaluate_workspace(MappedRobot(robot), grid, ("felt_stiffness",))
        print(f"{words:32}" + "".join(f"{entry.mean:12.3e}" for entry in found.distributions))
        poses = robot.solve(grid, on_failure="nan")
        away = np.linalg.norm(poses.positions[poses.within_limits, :2], axis=-1).max()
        print(f"  {found.reachable:.1%} of the ranges reachable; tool point up to {1e3 * away:.1f} mm off the vertical")


def universal_joint_figure(robots: Mapping[str, Robot], height: float) -> Figure:
    """Draw the passive leg and the felt stiffness of two robots while the platform tilts about y at a height [m]."""
    with house_style():
        figure = new_figure(TWO_COLUMNS, 4.4)
        grid = figure.add_gridspec(
            2, 3, left=0.085, right=0.985, top=0.94, bottom=0.1, wspace=0.32, hspace=0.5, width_ratios=[1.25, 1, 1]
        )
        motions = [figure.add_subplot(grid[row, 0]) for row in (0, 1)]
        panels = [figure.add_subplot(grid[row, column]) for row in (0, 1) for column in (1, 2)]
        for (words, robot), motion, color in zip(robots.items(), motions, COLORS, strict=True):
            poses = robot.solve(robot.grid(theta_y=(TILTS[0], TILTS[-1], len(TILTS)), z_e=height), on_failure="nan")
            inside = poses.within_limits
            felt = np.full((len(TILTS), 6), np.nan)
            felt[inside] = evaluate(robot, poses[inside], AXIS_STIFFNESS).values
            for panel, (axis, (name, size, unit)) in zip(panels, AXES.items(), strict=True):
                panel.plot(np.degrees(TILTS), felt[:, axis] / size, color=color)
                panel.set_title(f"felt {entry_words(name)} [{unit}]")
            draw_motion(motion, robot, height, color)
            motion.set_title(words, color=color)
        for panel in panels:
            panel.set(xlabel=r"$\theta_y$ [deg]", xlim=(-40.0, 40.0), ylim=(0.0, 1.05 * panel.dataLim.y1))
            panel.grid(color="#DDDDDD", linewidth=0.5)
    return figure


def draw_motion(axes: Axes, robot: Robot, height: float, color: str) -> None:
    """Draw passive leg and platform at some tilts, seen along y, with the universal joint as a dot."""
    clamp = robot.home.frame_placement("M").translation[[0, 2]]
    for tilt in np.radians(DRAWN_TILTS):
        configuration = robot.solve([0.0, tilt, height]).configuration()
        tool = configuration.frame_placement("O_e")
        joint = configuration.frame_placement("passive_cross").translation[[0, 2]]
        point, along = tool.translation[[0, 2]], HALF * tool.rotation[[0, 2], 0]
        width = 2.0 if tilt == 0.0 else 1.0
        for ends in ((clamp, point), (point - along, point + along)):
            axes.plot(*(1e3 * np.array(ends)).T, color=color, linewidth=width)
        axes.plot(*(1e3 * point), "o", color="white", markeredgecolor=color, markersize=4.0)
        axes.plot(*(1e3 * joint), "o", color=INK, markersize=5.0, zorder=3)
    axes.axvline(0.0, color=INK, linewidth=0.5, linestyle=(0, (6, 3)), zorder=0)
    axes.set(aspect="equal", xlabel="$x$ [mm]", ylabel="$z$ [mm]", xlim=(-150.0, 150.0), ylim=(365.0, 545.0))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder to write to")
    parser.add_argument("--points", type=int, default=POINTS, help="number of values of each coordinate")
    main(**vars(parser.parse_args()))
