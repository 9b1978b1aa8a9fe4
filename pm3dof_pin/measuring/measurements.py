"""Measurements of a machine: which commands were given, where the tool was seen, and how that differs from a model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pm3dof_pin.errors.pose_error import pose_difference, rotation_vector_rates
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.measuring.instrument import Instrument, Measured
from pm3dof_pin.measuring.registration import Registration
from pm3dof_pin.typing import Array, Indices

_SAME = 1e-9  # [m, rad], commands that differ by less are one pose


@dataclass(frozen=True, eq=False)
class Measurements:
    """Commands and the poses, positions or points that were seen, row after row.

    Example:
        >>> import numpy as np
        >>> import pm3dof_pin as pm
        >>> poses = pm.load("pm3dof").forward([[0.24, 0.24, 0.24], [0.25, 0.24, 0.23]])
        >>> len(pm.Measurements.of_poses(poses.commands, poses.transforms))
        2

    Attributes:
        commands: what the drives' counters showed, shape=(n, number of commands) [m, rad].
        positions: what was seen of the tool point, or of `points`, in the world, shape=(n, 3) [m].
        rotations: orientation of the tool, shape=(n, 3, 3); None if positions only were measured.
        sigmas: noise of each measured coordinate (x, y, z, then about these axes), shape=(n, 6) or (n, 3) [m, rad].
        points: the points seen, in the tool's axes from the tool point, shape=(n, 3) [m]; zeros for the tool point.
        conditions: temperatures and loads by the name of their column, shape=(n,) each.
        lines: line of the file of each row, shape=(n,); counted from 2 where there is no file.
        warnings: what is odd about them.
        registration: how they came into the axes of the base; None if they were measured in them.
    """

    commands: Array
    positions: Array
    rotations: Array | None
    sigmas: Array
    points: Array
    conditions: dict[str, Array] = field(default_factory=dict)
    lines: tuple[int, ...] = ()
    warnings: tuple[str, ...] = ()
    registration: Registration | None = None

    def __post_init__(self) -> None:
        """Check shapes and numbers.

        Raises:
            InvalidValueError: arrays that do not fit each other, numbers that are not finite, noise that is not
                positive.
        """
        n = len(self.commands)
        if not self.lines:
            object.__setattr__(self, "lines", tuple(range(2, n + 2)))
        shapes: dict[str, tuple[Array, tuple[int, ...]]] = {
            "commands": (self.commands, (n, self.commands.shape[-1])),
            "positions": (self.positions, (n, 3)),
            "sigmas": (self.sigmas, (n, 3 if self.rotations is None else 6)),
            "points": (self.points, (n, 3)),
        }
        if self.rotations is not None:
            shapes["rotations"] = (self.rotations, (n, 3, 3))
        shapes |= {name: (values, (n,)) for name, values in self.conditions.items()}
        for name, (array, shape) in shapes.items():
            if array.shape != shape or not np.isfinite(array).all():
                raise InvalidValueError(
                    name, f"an array of shape {array.shape}", f"finite numbers of shape {shape}, one row a measurement"
                )
        if not np.all(self.sigmas > 0.0):
            raise InvalidValueError("sigmas", float(self.sigmas.min()), "positive numbers")

    def __len__(self) -> int:
        return len(self.commands)

    def __getitem__(self, rows: NDArray[np.bool_] | NDArray[np.intp] | Sequence[int] | slice) -> Measurements:
        """Return some of the rows."""
        chosen = np.arange(len(self))[rows]
        return replace(
            self,
            commands=self.commands[chosen],
            positions=self.positions[chosen],
            rotations=None if self.rotations is None else self.rotations[chosen],
            sigmas=self.sigmas[chosen],
            points=self.points[chosen],
            conditions={name: values[chosen] for name, values in self.conditions.items()},
            lines=tuple(self.lines[k] for k in chosen),
        )

    @property
    def measured(self) -> Measured:
        """What was seen: "pose" or "position"."""
        return "position" if self.rotations is None else "pose"

    @classmethod
    def of_poses(cls, commands: Array, transforms: Array, instrument: Instrument | None = None) -> Measurements:
        """Make measurements of whole poses, or of what an instrument sees of them.

        Args:
            commands: what the drives' counters showed, shape=(n, number of commands) [m, rad].
            transforms: poses seen, shape=(n, 4, 4).
            instrument: whose noise they have.
        """
        seen_by = instrument or Instrument()
        poses = np.asarray(transforms, dtype=float)
        return cls(
            np.array(commands, dtype=float),
            poses[:, :3, 3],
            poses[:, :3, :3] if seen_by.measured == "pose" else None,
            np.tile(seen_by.sigmas, (len(poses), 1)),
            np.zeros((len(poses), 3)),
        )

    @property
    def pose_numbers(self) -> Indices:
        """Number of the pose of each row, counted from 0 as they appear: rows at the same commands are one pose."""
        _, first, poses = np.unique(np.round(self.commands / _SAME), axis=0, return_index=True, return_inverse=True)
        return np.asarray(np.argsort(np.argsort(first))[poses.reshape(-1)])

    def residuals(self, poses: Poses) -> Array:
        """Return what was measured minus what a machine does, shape=(n, 3 or 6) [m, rad].

        Positions of the points seen, then the rotation vector that leads from the machine's orientation to the one
        measured; world axes.

        Args:
            poses: of the machine, at the commands of the measurements.
        """
        offsets = np.einsum("nij,nj->ni", poses.rotations, self.points)
        positions = self.positions - poses.positions - offsets
        if self.rotations is None:
            return np.asarray(positions)
        seen = np.tile(np.eye(4), (len(poses), 1, 1))
        seen[:, :3, :3] = self.rotations
        return np.concatenate([positions, pose_difference(poses.transforms, seen)[:, 3:]], axis=1)

    def derivatives(self, poses: Poses, tool_motions: Array) -> Array:
        """Return the derivatives of minus the residuals by whatever moves the tool, shape=(n, 3 or 6, k).

        Args:
            poses: of the machine, at the commands of the measurements.
            tool_motions: derivatives of the tool's pose, shape=(n, 6, k).
        """
        offsets = np.einsum("nij,nj->ni", poses.rotations, self.points)
        linear, angular = tool_motions[:, :3], tool_motions[:, 3:]
        points = linear + np.cross(angular, offsets[:, :, None], axisa=1, axisb=1, axisc=1)
        if self.rotations is None:
            return np.asarray(points)
        rates = rotation_vector_rates(self.rotations @ np.swapaxes(poses.rotations, 1, 2))
        return np.concatenate([points, rates @ angular], axis=1)
