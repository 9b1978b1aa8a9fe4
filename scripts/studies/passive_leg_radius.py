"""What a passive leg of a larger radius brings, in both models: a table on the terminal and a picture in results/."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.axis_stiffness import READINGS
from pm3dof_pin.chapter.chapter_stiffness import AXES
from pm3dof_pin.chapter.limits import limit_flags
from pm3dof_pin.chapter.passive_leg import with_passive_leg_radius
from pm3dof_pin.figures.passive_leg_radius import passive_leg_radius_figure
from pm3dof_pin.figures.style import FORMATS, save_pictures

RESULTS = Path(__file__).resolve().parents[2] / "results"
FACTORS = (1.1, 1.2, 1.5, 2.0)


def main(out: Path = RESULTS) -> None:
    tripod = Tripod.load()
    print(*save_pictures(passive_leg_radius_figure(tripod), out / "passive_leg_radius", FORMATS), sep="\n")
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


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder to write to")
    main(**vars(parser.parse_args()))
