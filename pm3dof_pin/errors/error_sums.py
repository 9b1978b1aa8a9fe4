"""Sums over independent errors, for maps, reduced inside the program of the sensitivities.

To first order the tool moves by sum of sigma_k S_k x_k, with x_k independent, of mean 0 and standard deviation 1, and
sensitivities S. A pose takes one number instead of six per error. In doubt, or without a program, the same number is
computed by an :class:`~pm3dof_pin.errors.error_budget.ErrorBudget`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, Unpack

import numpy as np

from pm3dof_pin.description.coordinates import TOOL_COMPONENTS
from pm3dof_pin.errors.error_budget import error_budget
from pm3dof_pin.errors.normal_vectors import mean_radius
from pm3dof_pin.errors.pose_error import TIP_LENGTH
from pm3dof_pin.errors.sensitivity_program import Motions, Outputs, reduced
from pm3dof_pin.errors.source_errors import ErrorSources
from pm3dof_pin.kinematics.closing_programs import BoundProgram
from pm3dof_pin.kinematics.pose_values import PROGRAM_FROM, BatchOptions, PoseValues, evaluate_at
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.programs.elimination import eliminate, squared_singular_values, total, zeros
from pm3dof_pin.programs.graph import Scalar, absolute, minimum, sqrt
from pm3dof_pin.typing import Array, Mask, Matrix, Objects

KinematicSum = Literal["tip_rms", "worst_tip", "left_rms", "energy"]
"""Sums over the class "kinematic parameters", named as in :class:`~pm3dof_pin.errors.error_budget.ErrorBudget`."""

_CLASS = "kinematic parameters"


def kinematic_sum(
    sources: ErrorSources,
    poses: Poses,
    name: KinematicSum,
    *,
    eta: float = TIP_LENGTH,
    **options: Unpack[BatchOptions],
) -> PoseValues:
    """Compute a sum over geometric errors and guideway waviness at many poses, shape=(...) [m].

    Args:
        sources: the sources with their magnitudes.
        poses: poses of the robot as described.
        name: name of the sum.
        eta: weight of the orientation in the tip error [m/rad].
        options: see :class:`~pm3dof_pin.kinematics.pose_values.BatchOptions`.

    Raises:
        PM3DofError: see :func:`~pm3dof_pin.errors.error_budget.error_budget`.
    """
    robot = sources.robot
    robot.require_regular_drives(from_home=False)

    def program(q: Matrix, threads: int | None) -> tuple[Array, Mask]:
        flat, sound = kinematic_sum_program(sources, name, eta).with_doubt(q, threads)
        if name == "energy":
            flat = mean_radius(flat.reshape(-1, 2, 3)) @ [[1.0], [eta]]
        return flat, sound

    return evaluate_at(
        robot,
        poses,
        name,
        (),
        program=program,
        reference=lambda q: getattr(error_budget(sources, robot.at([q]), eta=eta, names=[_CLASS]), name),
        program_from=PROGRAM_FROM,
        **options,
    )


def kinematic_sum_program(sources: ErrorSources, name: KinematicSum, eta: float = TIP_LENGTH) -> BoundProgram:
    """Return the program of a sum at q [m]; of the energy that of the deviations along principal axes, shape=(2, 3).

    Raises:
        ProgramError: see :func:`~pm3dof_pin.errors.sensitivity_program.evaluated`.
    """
    numbers, values = sources.kinematic, {"eta": eta}
    counted = np.isin(TOOL_COMPONENTS, sources.robot.tool_motions)
    label = "_".join([f"error_{name}", *(() if counted.all() else sources.robot.tool_motions)])
    for k, (deviation, greatest) in enumerate(zip(numbers.deviations, numbers.greatest, strict=True)):
        values |= {f"deviation/{k}": float(deviation), f"greatest/{k}": float(deviation * greatest)}
    return BoundProgram(
        *reduced(label, numbers.errors, lambda motions: _recorded(name, motions, values, counted), values)
    )


def _recorded(name: KinematicSum, motions: Motions, values: Mapping[str, float], counted: Mask) -> Outputs:
    """Record a sum; for the energy, the eigenvalues of the covariances of position and orientation instead.

    Only the components of the tool's motion that count are summed, shape=(6,).
    """
    number = {name: motions.graph.parameter(name, value) for name, value in values.items()}
    columns = np.hstack([motions.errors, motions.drives])
    deviations, greatest = (
        np.array([number[f"{kind}/{k}"] for k in range(columns.shape[1])], dtype=object)
        for kind in ("deviation", "greatest")
    )
    if name == "energy":
        columns = np.where(counted[:, None], columns, 0.0)
        parts = (columns[:3] * deviations, columns[3:] * deviations)
        return {name: np.array([_covariance_eigenvalues(rows) for rows in parts], dtype=object)}
    weighted = np.vstack([columns[:3], columns[3:] * number["eta"]])[counted]
    if name == "worst_tip":
        return {name: np.array(_bound(weighted, greatest), dtype=object)}
    spread = weighted * deviations
    if name == "left_rms":
        count = motions.drives.shape[1]
        control = weighted[:, -count:]
        spread = eliminate(np.hstack([control, spread]), range(count), motions.doubt).rest[:, count:]
    return {name: np.array(_length(spread), dtype=object)}


def _length(entries: Objects) -> Scalar:
    return sqrt(total([entry * entry for entry in entries.ravel()]))


def _bound(weighted: Objects, greatest: Objects) -> Scalar:
    """Return the smaller of the length of the greatest components and the sum of lengths."""
    components = [total([absolute(e) * g for e, g in zip(row, greatest, strict=True)]) for row in weighted]
    added = total([_length(column) * g for column, g in zip(weighted.T, greatest, strict=True)])
    return minimum(_length(np.array(components, dtype=object)), added)


def _covariance_eigenvalues(rows: Objects) -> list[Scalar]:
    covariance = zeros(3, 3)
    for i in range(3):
        for j in range(3):
            covariance[i, j] = total([a * b for a, b in zip(rows[i], rows[j], strict=True)])
    return [sqrt(square) for square in squared_singular_values(covariance)]
