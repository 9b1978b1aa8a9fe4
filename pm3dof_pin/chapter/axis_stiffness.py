"""Stiffness on the chapter's six axes in the elastic model, K_jj and 1 / C_jj, for comparison with the chapter."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.chapter.elastic_stiffness import elastic_stiffness
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.elastic import indices
from pm3dof_pin.elastic.definite_inverse import inverse_definite
from pm3dof_pin.typing import Array

_ROWS = (3, 4, 2, 0, 1, 5)  # rows of K and C, in the order of the chapter's AXES


def held_stiffness(tripod: Tripod, poses: ArrayLike) -> Array:
    """Return K_jj: the force for a motion along each axis with all others held, shape=(..., 6) [N/m or N m/rad].

    Poses and errors are those of :func:`~pm3dof_pin.chapter.chapter_stiffness.chapter_stiffness`.
    """
    return np.diagonal(elastic_stiffness(tripod, poses), axis1=-2, axis2=-1)[..., _ROWS]


def felt_stiffness(tripod: Tripod, poses: ArrayLike) -> Array:
    """Return 1 / C_jj: the stiffness felt by a probe that loads each axis and leaves all other motions free.

    Arguments, result and errors as for :func:`held_stiffness`.
    """
    flexibility = inverse_definite(elastic_stiffness(tripod, poses))
    return indices.axis_stiffness(np.diagonal(flexibility, axis1=-2, axis2=-1))[..., _ROWS]
