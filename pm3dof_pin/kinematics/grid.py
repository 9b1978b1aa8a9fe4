"""Product grids over the coordinates of a robot."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pm3dof_pin.arrays import frozen
from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.typing import Array, Mask

_MAX_NUMBERS = 1_000_000_000  # coordinates of all poses of a grid that are computed at once: 8 GB


def require_few(poses: int, numbers: int) -> None:
    """Check that poses with so many numbers each can be computed at once.

    Raises:
        InvalidValueError: they cannot.
    """
    if poses * numbers > _MAX_NUMBERS:
        most = f"at most {_MAX_NUMBERS // numbers:,} at once"
        ways = "give ranges (--range) fewer points, or some coordinates one value (--at)"
        raise InvalidValueError("grid", f"{poses:,} poses", f"{most}: {ways}")


@dataclass(frozen=True, eq=False)
class Grid:
    """All combinations of the values of some coordinates, with the others fixed.

    Example:
        >>> import pm3dof_pin as pm
        >>> grid = pm.load("pm3dof").grid(theta_x=(-0.2, 0.2, 5), z_e=0.5)
        >>> grid.dims, grid.shape, grid.fixed
        (('theta_x',), (5,), {'theta_y': 0.0, 'z_e': 0.5})

    Attributes:
        coordinates: all coordinates of the robot, in order.
        axes: values by coordinate, in order of the grid's dimensions, shape=(n,) each [m, rad].
        fixed: values of the other coordinates [m, rad].
    """

    coordinates: tuple[Coordinate, ...]
    axes: Mapping[str, Array]
    fixed: Mapping[str, float]

    def __post_init__(self) -> None:
        """Check names and values."""
        names = tuple(coordinate.name for coordinate in self.coordinates)
        for name, value in {**self.axes, **self.fixed}.items():
            values: Array = np.asarray(value)
            if name not in names:
                raise InvalidValueError("coordinate", name, f"one of {', '.join(names)}")
            if values.ndim != (name in self.axes) or not values.size or not np.isfinite(values).all():
                raise InvalidValueError(f"values of {name}", values, "finite numbers")
        missing = [name for name in names if name not in self.axes and name not in self.fixed]
        if missing:
            raise InvalidValueError("coordinates without a value", ", ".join(missing), "one value or a range for each")

    @property
    def dims(self) -> tuple[str, ...]:
        """Names of the dimensions."""
        return tuple(self.axes)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values along each dimension."""
        return tuple(len(values) for values in self.axes.values())

    @property
    def size(self) -> int:
        """Number of poses."""
        return math.prod(self.shape)

    @cached_property
    def values(self) -> Array:
        """The coordinates of every pose, shape=(*shape, number of coordinates) [m, rad].

        Raises:
            InvalidValueError: there are too many.
        """
        require_few(self.size, len(self.coordinates))
        values = np.empty((*self.shape, len(self.coordinates)))
        dims = self.dims
        for column, coordinate in enumerate(self.coordinates):
            if coordinate.name in dims:
                after = len(dims) - 1 - dims.index(coordinate.name)
                values[..., column] = np.reshape(self.axes[coordinate.name], (-1, *[1] * after))
            else:
                values[..., column] = self.fixed[coordinate.name]
        return frozen(values)

    def part(self, slices: tuple[slice, ...]) -> Grid:
        """Return a part of the grid by one slice per dimension."""
        axes = {name: values[part] for (name, values), part in zip(self.axes.items(), slices, strict=True)}
        return Grid(self.coordinates, axes, self.fixed)


def with_neighbours(mask: Mask) -> Mask:
    """Return a mask grown by its neighbours, diagonal ones included."""
    grown = mask.copy()
    for axis in range(mask.ndim):
        along = np.moveaxis(grown, axis, 0)
        before = along.copy()
        along[1:] |= before[:-1]
        along[:-1] |= before[1:]
    return grown
