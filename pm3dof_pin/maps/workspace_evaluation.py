"""Quantities evaluated over the reachable set: mean, spread, extremes, global indices, and critical springs.

A pose of the grid represents its cell, cut at the edges of the grid (the trapezoidal rule). So averages are over the
volume of the reachable set in the robot's coordinates, each in its own unit, and independent of the grid's density.
There are two global indices of the stiffness:

- the mean of its diagonal, averaged over the workspace: D. Zhang, Parallel Robotic Machine Tools (Springer 2010). It
  adds N/m and N m/rad, and so depends on the unit of length;
- the mean of 1 / condition number: C. Gosselin and J. Angeles, J. Mechanical Design 113 (1991), who define it for
  Jacobians; here for the stiffness at its characteristic length, 1 if the tool is equally stiff in all its motions.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pm3dof_pin.elastic.batch import evaluate
from pm3dof_pin.elastic.quantities import STIFFNESS
from pm3dof_pin.exceptions import UnreachablePoseError
from pm3dof_pin.kinematics.grid import Grid
from pm3dof_pin.maps.datasets import BROKEN_LIMITS, unit_of_entry
from pm3dof_pin.maps.grid_map import quantity_map
from pm3dof_pin.maps.quantity import MappedRobot
from pm3dof_pin.typing import Array, Mask

if TYPE_CHECKING:
    import xarray as xr

SHARES = "spring_shares"
CRITICAL = "critical_spring"
STIFFER = 0.1
"""Relative stiffening of a spring to evaluate its gain."""

TIE = 1e-6
"""Shares that differ by less than this are treated as equal: springs that mirror each other."""

_ELASTIC = ("felt_stiffness", "translational_stiffness", "rotational_stiffness", "condition_number")
_OF_FREE_MOTIONS = ("free_stiffness", "felt_stiffness")


@dataclass(frozen=True)
class Distribution:
    """One number over the volume of the reachable set: its moments, extremes and their coordinates [m, rad]."""

    name: str
    entry: str  #: label of the entry, "" for a scalar
    unit: str
    mean: float
    standard_deviation: float
    least: float
    greatest: float
    least_at: dict[str, float]
    greatest_at: dict[str, float]
    defined_part: float  #: fraction of the reachable volume in which it has a finite value

    @property
    def label(self) -> str:
        """Name and entry as one word."""
        return f"{self.name}_{self.entry}" if self.entry else self.name


@dataclass(frozen=True)
class SpringRank:
    """Importance of one spring for one axis of the tool, over the reachable set."""

    axis: str  #: x, y, z, rx, ry or rz: the tool loaded along it and otherwise free
    spring: str  #: name of the spring
    governs_part: float  #: fraction of the volume in which it contributes most; equal springs share it equally
    mean_share: float  #: its share of the deflection, averaged over the volume
    least_share: float  #: the least such share
    greatest_share: float  #: the greatest such share
    #: lower bound of the relative gain in felt stiffness if the spring is made stiffer by :data:`STIFFER`, averaged
    #: over the volume; exact if the load path is unique
    gain_of_10_percent_at_least: float
    gain_of_10_percent_at_most: float  #: upper bound


@dataclass(frozen=True, eq=False)
class WorkspaceEvaluation:
    """A robot evaluated over its reachable set."""

    #: the quantities over the grid, NaN where a limit excludes the pose; with the shares of the springs, also
    #: `critical_spring`, the spring that contributes most for each axis
    dataset: xr.Dataset
    reachable: float  #: fraction of the grid's volume that is reachable
    distributions: tuple[Distribution, ...]  #: of every quantity and entry
    indices: dict[str, float]  #: the global indices; empty if the elastic stiffness was not requested
    #: rank of every spring for every axis, most important first; empty without the shares of the springs
    springs: tuple[SpringRank, ...]


def evaluate_workspace(
    mapped: MappedRobot,
    grid: Grid,
    quantities: Sequence[str] | None = None,
    *,
    springs: bool = True,
) -> WorkspaceEvaluation:
    """Evaluate quantities of a robot, by default the elastic stiffness, over the reachable part of a grid.

    With `springs`, the springs are ranked and the indices of the elastic stiffness computed.

    Raises:
        UnreachablePoseError: no pose of the grid is within the limits.
        InvalidValueError: an unknown quantity, or one that the robot does not have.
        DescriptionError: a quantity needs springs, and the robot has none.
    """
    names = tuple(stiffness_quantities(mapped) if quantities is None else quantities)
    matrix = ("free_stiffness" if _has_rigid_directions(mapped) else "stiffness",) if springs else ()
    every = tuple(dict.fromkeys((*names, *matrix, *((SHARES,) if springs else ()))))
    dataset = quantity_map(mapped, grid, every)
    weights = _cell_volumes(grid)
    inside = dataset[BROKEN_LIMITS].values == 0
    if not inside.any():
        raise UnreachablePoseError(
            f"{mapped.robot.name}: no pose of the grid over {', '.join(grid.dims)} is within all limits"
        )
    indices: dict[str, float] = {}
    for name in matrix:
        variable = dataset[name]
        units = [unit_of_entry(variable.attrs["units"], str(entry)) for entry in variable[variable.dims[-1]].values]
        turns = np.array([unit == "N m/rad" for unit in units]) if name == "free_stiffness" else np.arange(6) >= 3
        indices = _global_indices(variable.values[inside], turns, weights[inside])
    ranks: tuple[SpringRank, ...] = ()
    if springs:
        dataset = _with_critical_springs(dataset)
        ranks = tuple(_ranks(dataset, inside, weights))
    found = tuple(entry for name in names for entry in _distributions(dataset, name, grid, inside, weights))
    kept = dataset.drop_vars([name for name in matrix if name not in names])
    return WorkspaceEvaluation(kept, float(weights[inside].sum() / weights.sum()), found, indices, ranks)


def stiffness_quantities(mapped: MappedRobot) -> tuple[str, ...]:
    """Return the quantities of a robot's stiffness: those of its 6 x 6 matrix or, without one, of its free motions."""
    return _OF_FREE_MOTIONS if _has_rigid_directions(mapped) else _ELASTIC


def _has_rigid_directions(mapped: MappedRobot) -> bool:
    """Tell whether the tool is rigid in some direction, so that only its free motions have a stiffness."""
    usual = evaluate(mapped.elastic, mapped.usual_poses, STIFFNESS, on_failure="nan", engine="pinocchio")
    has_stiffness = np.isfinite(usual.values).all(axis=(1, 2)).any()
    return not has_stiffness and mapped.free_motions is not None


def _cell_volumes(grid: Grid) -> Array:
    """Return the volume represented by each pose of a grid, by the trapezoidal rule, shape=grid.shape [m, rad]."""
    volumes = np.ones(grid.shape)
    for axis, values in enumerate(grid.axes.values()):
        lengths = np.ones(1)
        if len(values) > 1:
            steps = np.abs(np.diff(values))
            lengths = 0.5 * (np.append(steps, 0.0) + np.append(0.0, steps))
        volumes *= lengths.reshape(-1, *[1] * (len(grid.shape) - axis - 1))
    return volumes


def _distributions(dataset: xr.Dataset, name: str, grid: Grid, inside: Mask, weights: Array) -> Iterator[Distribution]:
    variable = dataset[name]
    own = tuple(map(str, variable.dims[len(grid.shape) :]))
    for entry in [str(label) for label in variable[own[0]].values] if own else [""]:
        if len(own) == 2 and own[1] != f"{own[0]}_2":
            rows = [(f"{entry}_{other}", {own[0]: entry, own[1]: other}) for other in variable[own[1]].values]
        else:  # the diagonal of matrices
            rows = [(entry, dict.fromkeys(own, entry))]
        for label, place in rows:
            values = variable.sel(place).values
            known = inside & np.isfinite(values)
            if known.any():
                unit = unit_of_entry(variable.attrs["units"], entry)
                yield _distribution(name, label, unit, np.where(known, values, np.nan), grid, inside, weights)


def _distribution(
    name: str, entry: str, unit: str, values: Array, grid: Grid, inside: Mask, weights: Array
) -> Distribution:
    known = np.isfinite(values)
    volume = weights[known]
    mean = float(np.average(values[known], weights=volume))
    deviation = math.sqrt(float(np.average((values[known] - mean) ** 2, weights=volume)))
    names = [coordinate.name for coordinate in grid.coordinates]
    # the first of symmetric poses, whichever rounding favours
    least, greatest = float(np.nanmin(values)), float(np.nanmax(values))
    alike = (values <= least + 1e-9 * abs(least), values >= greatest - 1e-9 * abs(greatest))
    ends = [np.unravel_index(int(np.argmax(extreme)), values.shape) for extreme in alike]
    places = [dict(zip(names, map(float, grid.values[end]), strict=True)) for end in ends]
    least, greatest = (float(values[end]) for end in ends)
    defined = float(volume.sum() / weights[inside].sum())
    return Distribution(name, entry, unit, mean, deviation, least, greatest, places[0], places[1], defined)


def _global_indices(stiffness: Array, turns: Mask, weights: Array) -> dict[str, float]:
    """Return both indices of stiffness matrices, shape=(n, p, p); `turns` marks rotational motions, shape=(p,)."""
    known = np.isfinite(stiffness).all(axis=(1, 2))
    matrices, volume = stiffness[known], weights[known]
    if not len(matrices):
        return {}
    diagonal = np.diagonal(matrices, axis1=1, axis2=2)
    scale = np.ones_like(diagonal)
    if turns.any() and not turns.all():
        sums = np.stack([diagonal[:, turns].sum(axis=1), diagonal[:, ~turns].sum(axis=1)])
        scale[:, turns] = np.sqrt(sums[1] / sums[0])[:, None]
    values = np.linalg.eigvalsh(matrices * scale[:, :, None] * scale[:, None, :])
    return {
        "mean_diagonal": float(np.average(diagonal.mean(axis=1), weights=volume)),
        "conditioning": float(np.average(values[:, 0] / values[:, -1], weights=volume)),
        "least_conditioning": float((values[:, 0] / values[:, -1]).min()),
    }


def _with_critical_springs(dataset: xr.Dataset) -> xr.Dataset:
    shares = dataset[SHARES]
    names = [str(name) for name in dataset["spring"].values]
    critical = np.where(np.isfinite(shares.values).all(axis=-1), np.argmax(_leading(shares.values), axis=-1), -1)
    attributes = {
        "long_name": "spring that contributes most to the deflection along the axis",
        "units": "1",
        "spring_numbers": " ".join(f"{number}:{name}" for number, name in enumerate(names, start=1)),
        "comment": "0 where a limit excludes the pose, or nothing deflects along the axis",
    }
    return dataset.assign({CRITICAL: (shares.dims[:-1], (critical + 1).astype(np.int16), attributes)})


def _leading(shares: Array) -> Mask:
    """Tell which springs have the greatest share, several if equal, shape=(..., springs)."""
    leading: Mask = shares >= shares.max(axis=-1, keepdims=True) - TIE
    return leading


def _ranks(dataset: xr.Dataset, inside: Mask, weights: Array) -> Iterator[SpringRank]:
    shares, critical = dataset[SHARES].values[inside], dataset[CRITICAL].values[inside]
    names = [str(name) for name in dataset["spring"].values]
    for number, axis in enumerate(map(str, dataset["axis"].values)):
        known = critical[:, number] > 0
        if not known.any():
            continue
        parts, volume = shares[known, number], weights[inside][known]
        means = np.average(parts, axis=0, weights=volume)
        leading = _leading(parts)
        governs = np.average(leading / leading.sum(axis=1, keepdims=True), axis=0, weights=volume)
        gains = np.average(1.0 / (1.0 - parts * STIFFER / (1.0 + STIFFER)) - 1.0, axis=0, weights=volume)
        for spring in np.argsort(-means, kind="stable"):
            yield SpringRank(
                axis,
                names[spring],
                float(governs[spring]),
                float(means[spring]),
                float(parts[:, spring].min()),
                float(parts[:, spring].max()),
                float(gains[spring]),
                float(STIFFER * means[spring]),
            )
