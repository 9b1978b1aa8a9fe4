"""A plan of measurements as CSV: commands to drive to, and where the tool should then be."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from pm3dof_pin.calibration.measurements import command_columns
from pm3dof_pin.calibration.planning import Plan
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import quaternion
from pm3dof_pin.files import write_text_atomically

NOMINAL_COLUMNS = tuple(f"nominal_{name}" for name in ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"))


def write_plan(errors: GeometricErrors, plan: Plan, path: Path | str) -> Path:
    """Write a plan, one row a pose, every digit kept.

    Commands count from where the machine's own do: joint coordinates plus the command offsets. The nominal pose is that
    of the machine as described; its columns are no measurement, and named so.

    Args:
        errors: the error parameters of the machine, with its command offsets.
        plan: the plan.
        path: file to write.

    Returns:
        The path written.

    Raises:
        OutputError: the file cannot be written; nothing is left of it.
    """
    commands = plan.poses.commands
    rows = np.concatenate([commands, plan.poses.positions, quaternion(plan.poses.rotations)], axis=1)
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*command_columns(errors.mechanism), *NOMINAL_COLUMNS])
    writer.writerows([[repr(float(number)) for number in row] for row in rows])
    return write_text_atomically(path, text.getvalue())
