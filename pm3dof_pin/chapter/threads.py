"""Running a compiled kernel over many poses on all processors: the kernels leave the interpreter lock."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from pm3dof_pin.typing import Array

_CHUNK = 8_192  # poses; their results fit a processor's cache


def over_poses(kernel: Callable[..., Any], poses: Array, out: Array, workers: int | None = None) -> None:
    """Fill `out` with kernel(poses), chunk by chunk, on several threads.

    Args:
        kernel: takes poses of shape (m, 3) and `out` of shape (m, ...).
        poses: shape=(..., 3).
        out: shape=(..., *shape of one result), contiguous.
        workers: threads; the number of processors by default.
    """
    flat_poses = poses.reshape(-1, 3)
    flat_out = out.reshape(len(flat_poses), *out.shape[poses.ndim - 1 :])

    def fill(first: int) -> None:
        part = slice(first, first + _CHUNK)
        kernel(flat_poses[part], out=flat_out[part])

    count = workers or os.cpu_count() or 1
    starts = range(0, len(flat_poses), _CHUNK)
    if count == 1 or len(starts) < 2:
        for first in starts:
            fill(first)
        return
    with ThreadPoolExecutor(count) as pool:
        for finished in [pool.submit(fill, first) for first in starts]:
            finished.result()
