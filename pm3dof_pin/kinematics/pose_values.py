"""Values at many poses: from a compiled program, and by the reference where that is in doubt."""

from __future__ import annotations

import logging
import math
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import TypedDict

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import real_array, require_choice
from pm3dof_pin.exceptions import PM3DofError, ProgramError, ShapeError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.typing import Array, Engine, Mask, Matrix, OnFailure, Vector

PROGRAM_FROM = 200
"""Number of poses for fewer of which Pinocchio takes no longer than recording and compiling most programs."""

_KEPT = "_evaluated_poses"

_logger = logging.getLogger(__name__)


class BatchOptions(TypedDict, total=False):
    """Options of functions that evaluate many poses."""

    on_failure: OnFailure  #: "raise", or "nan" for poses that are unsolved or have no value
    engine: Engine | None  #: instead of the robot's, see :meth:`Robot.with_engine`
    threads: int | None  #: instead of the robot's


@dataclass(frozen=True, eq=False)
class PoseValues:
    """Values at many poses."""

    values: Array  #: shape=(..., *shape of one value); NaN where there is none
    redone: Mask  #: poses where the program was in doubt and Pinocchio and singular values decided, shape=(...)
    failed: Mask  #: poses without a value, shape=(...)


def evaluate_at(
    robot: Robot,
    poses: Poses | Configuration | ArrayLike,
    name: str,
    shape: tuple[int, ...],
    *,
    program: Callable[[Matrix, int | None], tuple[Array, Mask]],
    reference: Callable[[Vector], ArrayLike],
    program_from: int = 0,
    on_failure: OnFailure = "raise",
    engine: Engine | None = None,
    threads: int | None = None,
) -> PoseValues:
    """Evaluate a quantity, named for the log, at many poses or configurations q, shape=(..., nq).

    `program` maps configurations, shape=(n, nq), and threads to values, shape=(n, size), and a mask of those not in
    doubt, shape=(n,); it raises ProgramError if there is no program. `reference` maps one configuration to its value of
    the given shape; it decides where the program is in doubt, and for fewer poses than `program_from`, counted over all
    calls for the robot and its variants. Unsolved poses fail without a computation if `on_failure` is "nan".

    Raises:
        InvalidValueError: `poses` has the wrong shape.
        PM3DofError: see `reference`.
    """
    require_choice("on_failure", on_failure, OnFailure)
    engine = robot.engine if engine is None else engine
    require_choice("engine", engine, Engine)
    q = poses.q if isinstance(poses, Poses | Configuration) else real_array("poses", poses)
    if q.shape[-1:] != (robot.model.nq,):
        expected = f"(..., {robot.model.nq}), joint positions q"
        if q.shape[-1:] == (len(robot.coordinates),):
            names = ", ".join(coordinate.name for coordinate in robot.coordinates)
            expected += f"; solve values of {names} first: robot.solve(values)"
        raise ShapeError("poses", q.shape, expected)
    rows = q.reshape(math.prod(q.shape[:-1]), q.shape[-1])
    known = np.asarray(np.isfinite(rows).all(axis=1)) if on_failure == "nan" else np.ones(len(rows), dtype=bool)
    asked = rows if known.all() else rows[known]
    values: Array | None = None
    doubtful = np.arange(len(asked))
    if engine == "program" and _are_many(robot, (name, shape), len(asked), max(program_from, 1)):
        with suppress(ProgramError):
            values, sound = program(asked, robot.threads if threads is None else threads)
            doubtful = np.flatnonzero(~sound)
    if values is None:
        values = np.empty((len(asked), math.prod(shape)))
    lacking = np.zeros(len(asked), dtype=bool)
    for index in doubtful:
        values[index] = np.nan
        try:
            values[index] = np.ravel(reference(asked[index]))
        except PM3DofError:
            if on_failure == "raise":
                raise
            lacking[index] = True
    redone, failed = np.zeros(len(rows), dtype=bool), np.ones(len(rows), dtype=bool)
    redone[np.flatnonzero(known)[doubtful]] = ~lacking[doubtful]
    failed[known] = lacking
    if asked is not rows:
        every = np.full((len(rows), *values.shape[1:]), np.nan)
        every[known] = values
        values = every
    if redone.any() or failed.any():
        _logger.info(
            "%s of %s: %d of %d poses computed by Pinocchio and singular values, %d without a value",
            *(name, robot.name, int(redone.sum()), len(rows), int(failed.sum())),
        )
    return PoseValues(values.reshape(*q.shape[:-1], *shape), redone.reshape(q.shape[:-1]), failed.reshape(q.shape[:-1]))


def _are_many(robot: Robot, quantity: object, count: int, many: int) -> bool:
    """Return whether a robot and its variants have had so many poses of a quantity evaluated, with `count` new ones."""
    counts: Counter[object] = vars(robot.prototype).setdefault(_KEPT, Counter())
    counts[quantity] += count
    return counts[quantity] >= many
