"""Effect of a larger passive-leg radius in both models: a printed table and a picture in results/."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullFormatter, ScalarFormatter

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.axis_stiffness import felt_stiffness, held_stiffness
from pm3dof_pin.chapter.chapter_stiffness import AXES, chapter_stiffness
from pm3dof_pin.chapter.limits import limit_flags
from pm3dof_pin.chapter.passive_leg import with_passive_leg_radius
from pm3dof_pin.figures.style import FORMATS, INK, TWO_COLUMNS, house_style, new_figure, save_pictures
from pm3dof_pin.typing import Array

RESULTS = Path(__file__).resolve().parents[2] / "results"
FACTORS = (1.1, 1.2, 1.5, 2.0)
READINGS = {"chapter": chapter_stiffness, "elastic, held": held_stiffness, "elastic, felt": felt_stiffness}
LINES = {  # axis shown: words, colour, width, dashes; at the centre of the section theta_y is as theta_x, t_y as t_x
    "theta_z": (r"$\theta_z$", "#D55E00", 3.2, "solid"),
    "t_x": ("$T_x, T_y$", "#56B4E9", 1.6, (0, (4, 2))),
    "theta_x": (r"$\theta_x, \theta_y$", "#0072B2", 1.6, "solid"),
    "t_z": ("$T_z$", INK, 1.6, (0, (1, 1.5))),
}
TITLES = {
    "chapter": "chapter's model",
    "elastic, held": "elastic, other motions held",
    "elastic, felt": "elastic, felt by a probe",
}


def main(out: Path = RESULTS, formats: Sequence[str] = FORMATS) -> None:
    tripod = Tripod.load()
    print(*save_pictures(passive_leg_radius_figure(tripod), out / "passive_leg_radius", formats), sep="\n")
    tilts = np.radians(np.arange(-45.0, 46.0))
    poses = np.stack(np.meshgrid(tilts, tilts, tripod.middle_height, indexing="ij"), axis=-1).reshape(-1, 3)
    poses = poses[limit_flags(tripod, poses) == 0]
    print(f"\n{'radius [mm]':>12}{'E I [N m^2]':>14}{'G J [N m^2]':>14}{'E A [N]':>12}{'mass [kg]':>12}")
    for factor in (1.0, *FACTORS):
        p = with_passive_leg_radius(tripod, factor).parameters
        print(
            f"{1e3 * p.passive_leg.radius:12.2f}{p.bending_stiffness:14.2f}{p.torsional_stiffness:14.2f}"
            f"{p.axial_stiffness:12.3e}{p.passive_leg_mass:12.3f}"
        )
    print(
        f"\nstiffness over that of today's leg, least to greatest over {len(poses)} poses of the section of Table 8.3"
    )
    print(f"{'reading':16}{'radius':>8}" + "".join(f"{axis:>16}" for axis in AXES))
    for name, reading in READINGS.items():
        today = reading(tripod, poses)
        for factor in FACTORS:
            gains = reading(with_passive_leg_radius(tripod, factor), poses) / today
            ranges = zip(gains.min(axis=0), gains.max(axis=0), strict=True)
            print(f"{name:16}{factor:8.1f}" + "".join(f"{low:9.2f} ..{high:5.2f}" for low, high in ranges))


def passive_leg_radius_figure(tripod: Tripod) -> Figure:
    """Draw each axis' stiffness at the section's centre against the radius, both over those of today's leg."""
    factors = np.geomspace(1.0, 2.0, 41)
    centre = [0.0, 0.0, tripod.middle_height]
    machines = [with_passive_leg_radius(tripod, factor) for factor in factors]
    with house_style():
        figure = new_figure(TWO_COLUMNS, 3.1)
        panels = figure.subplots(1, 3, sharex=True, sharey=True)
        for axes, (name, reading) in zip(panels, READINGS.items(), strict=True):
            gains = np.stack([reading(machine, centre) for machine in machines]) / reading(tripod, centre)
            draw_panel(axes, TITLES[name], factors, gains)
        panels[0].set_ylabel("stiffness, times that of today's leg")
        handles = [
            Line2D([], [], label=words, color=color, linewidth=width, linestyle=dashes)
            for words, color, width, dashes in LINES.values()
        ]
        figure.legend(handles=handles, loc="lower center", ncols=len(handles), handlelength=3.0)
        figure.subplots_adjust(left=0.075, right=0.985, top=0.91, bottom=0.255, wspace=0.13)
    return figure


def draw_panel(axes: Axes, name: str, factors: Array, gains: Array) -> None:
    for axis, (_, color, width, dashes) in LINES.items():
        axes.plot(factors, gains[:, AXES.index(axis)], color=color, linewidth=width, linestyle=dashes)
    axes.axvline(1.2, color="#999999", linewidth=0.6)
    axes.set(xscale="log", yscale="log", xlim=(1.0, 2.0), ylim=(0.93, 17.5), xlabel="radius, times today's", title=name)
    axes.set_xticks([1.0, 1.2, 1.5, 2.0])
    axes.set_yticks([1, 2, 4, 8, 16])
    for along in (axes.xaxis, axes.yaxis):
        along.set_major_formatter(ScalarFormatter())
        along.set_minor_formatter(NullFormatter())
        along.set_tick_params(which="minor", length=0)
    axes.grid(color="#DDDDDD", linewidth=0.5)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder to write to")
    main(**vars(parser.parse_args()))
