"""The compliance at many configurations: Pinocchio's Jacobians in one loop, condensed on all processors meanwhile."""

from __future__ import annotations

import logging
import os
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Literal

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pm3dof_pin.elastic import sweep_kernels
from pm3dof_pin.elastic.condensation import cartesian_compliance
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.exceptions import InvalidValueError, PM3DofError
from pm3dof_pin.kinematics.degrees_of_freedom import ASSEMBLED_TOLERANCE
from pm3dof_pin.typing import Matrix, Vector

_logger = logging.getLogger(__name__)

_CHUNK = 512  # configurations; few of these wait at any time, whatever the number of all


def compliance_over(
    model: ElasticModel,
    positions: ArrayLike,
    *,
    frame: str | None = None,
    nonexistent: Literal["raise", "nan"] = "raise",
    workers: int | None = None,
) -> Matrix:
    """Compute the Cartesian compliance of a frame at many configurations.

    The same numbers as :func:`~pm3dof_pin.elastic.condensation.cartesian_compliance`, by orthogonal elimination with
    column pivoting. Configurations at which a pivot leaves a rank in doubt are done again with singular value
    decompositions. :func:`pm3dof_pin.elastic.indices.stiffness` gives K.

    Args:
        model: the elastic mechanism.
        positions: assembled configurations q of the rigid mechanism, shape=(n, nq) [m, rad].
        frame: the frame; the tool by default.
        nonexistent: "raise", or "nan" to mark configurations that are not assembled or not finite, those where a length
            that a joint changes is not positive, and those at which the frame is free. Their number is logged.
        workers: threads that condense, the number of processors by default. The result does not depend on it.

    Returns:
        C, twist = C wrench at the frame's origin, world axes, shape=(n, 6, 6) [m/N, 1/N, rad/(N m)].

    Raises:
        FreeDirectionError: the frame has free directions at a configuration, and `nonexistent` is "raise".
        InvalidValueError: a configuration is not assembled or not finite, or a length that a joint changes is not
            positive, and `nonexistent` is "raise"; or `positions` has another shape.
        FrameNotFoundError: the model has no such frame.
        DescriptionError: no frame is given, and the mechanism has no tool frame.
    """
    rigid = np.asarray(positions, dtype=np.float64)
    if rigid.ndim != 2:
        raise InvalidValueError("positions", f"array of shape {rigid.shape}", f"shape (n, {model.rigid.model.nq})")
    mechanism = model.mechanism
    frame_id = mechanism.tool_frame_id if frame is None else mechanism.frame_id(frame)
    compliances = np.full((len(rigid), 6, 6), np.nan)
    done = np.zeros(len(rigid), dtype=bool)
    sweep = _Sweep(model, frame_id)
    count = workers or os.cpu_count() or 1
    with ThreadPoolExecutor(count) as pool:
        waiting = deque[tuple[slice, Future[NDArray[np.bool_]]]]()
        for start in range(0, len(rigid), _CHUNK):
            chunk = slice(start, start + _CHUNK)
            waiting.append((chunk, pool.submit(sweep.condensation(rigid[chunk], compliances[chunk]))))
            if len(waiting) > count:
                earlier, finished = waiting.popleft()
                done[earlier] = finished.result()
        for earlier, finished in waiting:
            done[earlier] = finished.result()
    failures = 0
    for index in np.flatnonzero(~done):
        try:
            compliances[index] = cartesian_compliance(model, rigid[index], frame=frame).compliance
        except PM3DofError:
            if nonexistent == "raise":
                raise
            compliances[index] = np.nan
            failures += 1
    _logger.info("%d of %d configurations done again, %d without a compliance", (~done).sum(), len(rigid), failures)
    return compliances


class _Sweep:
    """What is the same at all configurations."""

    def __init__(self, model: ElasticModel, frame_id: int) -> None:
        self._model = model
        self._frame_id = frame_id
        mechanism, springs = model.mechanism, model.spring_indices
        self._scale = mechanism.velocity_scale
        self._units = np.append(mechanism.closure_scale, np.repeat([mechanism.characteristic_length, 1.0], 3))
        self._indices = np.concatenate([_few_loops_first(model), springs])
        self._root, self._powers = model.compliance_root
        sizes = [len(block.indices) for block in model.blocks]
        starts = np.cumsum([0, *sizes[:-1]])
        self._first_of_block = np.repeat(starts, sizes)
        softness = np.linalg.norm(self._root / self._scale[springs, None], axis=0)
        self._place = np.argsort(np.argsort(-softness, kind="stable"), kind="stable")

    def condensation(self, rigid: Matrix, compliances: Matrix) -> Callable[[], NDArray[np.bool_]]:
        """Compute the Jacobians; return what fills in compliances, shape=(n, 6, 6), and tells which are done."""
        mechanism = self._model.mechanism
        positions = self._model.embed(rigid)
        errors, closures, frames = mechanism.loop_kinematics.jacobians_over(
            positions, self._frame_id, pin.LOCAL_WORLD_ALIGNED
        )
        factors = self._factors(positions)
        assembled = np.abs(errors).max(axis=1, initial=0.0) <= ASSEMBLED_TOLERANCE * mechanism.characteristic_length

        def condense() -> NDArray[np.bool_]:
            done: NDArray[np.bool_] = sweep_kernels.condense_all(
                closures,
                frames,
                self._indices,
                len(self._model.passive_indices),
                self._scale[self._indices],
                self._units,
                self._root,
                self._first_of_block,
                factors,
                self._place,
                compliances,
            )
            finished: NDArray[np.bool_] = done & assembled & np.isfinite(compliances).all(axis=(1, 2))
            return finished

        return condense

    def _factors(self, positions: Matrix) -> Vector:
        """Return what the rows of the compliance's root are multiplied by; NaN where a length is not positive."""
        springs = self._model.spring_indices
        factors = np.tile(1.0 / self._scale[springs], (len(positions), 1))
        start = 0
        for block in self._model.blocks:
            rows = slice(start, start + len(block.indices))
            if block.length is not None:
                q = positions[:, self._model.mechanism.single_joint(block.length.joint).q_index]
                length = block.length.at_zero + q
                factors[:, rows] *= np.where(length > 0.0, length, np.nan)[:, None] ** self._powers[rows]
            start = rows.stop
        return factors


def _few_loops_first(model: ElasticModel) -> NDArray[np.intp]:
    """Return the passive joints' entries of v, those with a part in few closures first: it keeps zeros zero."""
    mechanism = model.mechanism
    tree = mechanism.model
    closures_of = np.zeros(tree.nv, dtype=np.intp)
    for closure in mechanism.closures:
        ends = (tree.frames[mechanism.frame_id(name)].parentJoint for name in (closure.frame_a, closure.frame_b))
        for joint in set.symmetric_difference(*(set(tree.supports[end]) for end in ends)) - {0}:
            start = tree.joints[joint].idx_v
            closures_of[start : start + tree.joints[joint].nv] += 1
    order: NDArray[np.intp] = model.passive_indices[np.argsort(closures_of[model.passive_indices], kind="stable")]
    return order
