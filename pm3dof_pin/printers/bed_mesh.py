"""What no parameter of a printer's firmware can express, as a mesh of heights of the bed for Klipper.

The heights that touches leave over a calibrated printer are interpolated by a thin-plate spline (J. Duchon, 1977) of a
smoothness chosen by touches held out, over the disc of the touches; beyond, a mesh continues as at its edge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from pm3dof_pin.printers.touches import are_clearly_smaller
from pm3dof_pin.typing import Array

POINTS = 9
"""Points along each side of a mesh."""

_LEAST = 10  # touches
_SMOOTHNESS = (0.01, 0.1, 1.0, 10.0)


@dataclass(frozen=True, eq=False)
class BedMesh:
    """Heights of the bed where a calibrated printer expects it at zero."""

    points: Array  #: places of the touches, shape=(touches, 2) [m]
    heights: Array  #: of the bed there, shape=(touches,) [m]
    smoothness: float  #: of the spline: the greater, the closer to a plane
    held_out: Array  #: errors at touches held out, of parameters and mesh together, shape=(touches,) [m]

    @classmethod
    def fitted(cls, points: Array, heights: Array, left_over: Array, folds: Array) -> BedMesh | None:
        """Fit a mesh; None if touches are too few, or it predicts held-out ones no better than none.

        Args:
            points: places of the touches, shape=(touches, 2) [m].
            heights: of the bed by the calibrated printer, shape=(touches,) [m].
            left_over: the same by the printer calibrated without each fold, shape=(folds, touches) [m].
            folds: fold of each touch, shape=(touches,).
        """
        if len(points) < _LEAST:
            return None
        trials = []
        for smoothness in _SMOOTHNESS:
            errors = np.zeros(len(points))
            for fold, own in enumerate(left_over):
                shown, hidden = folds != fold, folds == fold
                spline = _spline(points[shown], own[shown], smoothness)
                errors[hidden] = own[hidden] - spline(_scaled(points[hidden], points[shown]))
            trials.append(errors)
        best = min(range(len(trials)), key=lambda k: float(np.mean(trials[k] ** 2)))
        if not are_clearly_smaller(trials[best], left_over[folds, np.arange(len(folds))]):  # it only follows the noise
            return None
        return cls(points, heights, _SMOOTHNESS[best], trials[best])

    @property
    def radius(self) -> float:
        """Greatest distance of a touch from the centre of the bed [m]."""
        return float(np.linalg.norm(self.points, axis=1).max())

    def grid(self) -> Array:
        """Return heights over the square around the bed, rows along y, shape=(POINTS, POINTS) [m]."""
        side = np.linspace(-self.radius, self.radius, POINTS)
        places = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
        far = np.linalg.norm(places, axis=1)
        places *= (self.radius / np.maximum(far, self.radius))[:, None]
        found = _spline(self.points, self.heights, self.smoothness)(_scaled(places, self.points))
        return np.asarray(found).reshape(POINTS, POINTS)


def _scaled(places: Array, points: Array) -> Array:
    return np.asarray(places / np.linalg.norm(points, axis=1).max())


def _spline(points: Array, heights: Array, smoothness: float) -> scipy.interpolate.RBFInterpolator:
    return scipy.interpolate.RBFInterpolator(_scaled(points, points), heights, smoothing=smoothness)
