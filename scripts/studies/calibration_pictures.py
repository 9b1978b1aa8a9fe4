"""Draw the pictures of the documentation's page on calibration, from its own measurement file.

They are written under results/, or with --out docs/pictures where the documentation shows them.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import pm3dof_pin as pm
from pm3dof_pin.figures.style import save_figure

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "results"
MEASUREMENTS = ROOT / "docs" / "examples" / "measurements.csv"


def main(out: Path = RESULTS) -> None:
    pictures = pm.calibrate(MEASUREMENTS, "pm3dof").pictures()
    print(save_figure(pictures["tip_error_held_out"], out / "calibration_held_out.png"))
    print(save_figure(pictures["workspace"], out / "calibration_maps.png"))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder to write to")
    main(**vars(parser.parse_args()))
