"""Draw the pictures of the documentation's page on calibration, from its own measurement file.

They are written under results/, or with --out docs/pictures where the documentation shows them.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from pm3dof_pin.calibration.calibrate import Options, calibrate
from pm3dof_pin.calibration.judging import held_out_errors
from pm3dof_pin.calibration.workspace_errors import workspace_errors
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.figures.calibration import held_out_picture, workspace_picture
from pm3dof_pin.figures.style import save_figure
from pm3dof_pin.measuring.measurement_file import read_measurements

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "results"
MEASUREMENTS = ROOT / "docs" / "examples" / "measurements.csv"


def main(out: Path = RESULTS) -> None:
    errors = GeometricErrors.load("pm3dof")
    calibration = calibrate(read_measurements(MEASUREMENTS, errors.robot), errors, Options("lm+gp"))
    print(save_figure(held_out_picture(held_out_errors(calibration)), out / "calibration_held_out.png"))
    print(save_figure(workspace_picture(workspace_errors(calibration)), out / "calibration_maps.png"))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder to write to")
    main(**vars(parser.parse_args()))
