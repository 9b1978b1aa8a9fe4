"""The shortening of bending beams, which makes columns buckle and strings stiff."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pm3dof_pin.typing import Indices, Matrix, Vector


@dataclass(frozen=True, eq=False)
class Bow:
    """The shortening of a bending beam, b = d^T B d / 2, resisted by its axial stiffness c: U = c (z + b)^2 / 2.

    With w' the slope of the cubic bending line of the beam, b is half the integral of w'^2 along it. B times the axial
    force is the consistent geometric stiffness of a beam element (J. Przemieniecki, Theory of Matrix Structural
    Analysis, 1968, chapter 15).
    """

    axial: int  #: index in d of the elongation, z
    bending: Indices  #: indices in d of the bending, in the order x, ry, y, rx, shape=(4,)
    stiffness: float  #: c times the length, E A [N]
    length: float | None  #: length of the element [m]; None if it varies with a joint

    def energy_derivatives(self, d: Vector, length: float) -> tuple[Vector, Matrix]:
        """Return the derivatives of U - c z^2 / 2 by deflections d, shape=(n,), and, last, by the length [m].

        First derivatives, shape=(n + 1,), and second ones, shape=(n + 1, n + 1).
        """
        size, bent = len(d) + 1, d[self.bending]
        matrix, rate = _shape(length)
        axial, slope, curvature = np.zeros(size), np.zeros(size), np.zeros((size, size))  # of z, of b
        axial[self.axial] = 1.0
        slope[self.bending], slope[-1] = matrix @ bent, 0.5 * bent @ rate @ bent
        curvature[np.ix_(self.bending, self.bending)] = matrix
        curvature[self.bending, -1] = curvature[-1, self.bending] = rate @ bent
        curvature[-1, -1] = 1.2 / length**3 * (bent[0] ** 2 + bent[2] ** 2)
        z, b = d[self.axial], 0.5 * bent @ matrix @ bent
        # c g with g = z b + b^2 / 2
        g = z * b + 0.5 * b * b
        g_first = b * axial + (z + b) * slope
        g_second = np.outer(axial, slope) + np.outer(slope, axial) + np.outer(slope, slope) + (z + b) * curvature
        c = self.stiffness / length
        c_first = np.zeros(size)
        c_first[-1] = -c / length
        first: Vector = c_first * g + c * g_first
        second: Matrix = np.outer(c_first, g_first) + np.outer(g_first, c_first) + c * g_second
        second[-1, -1] += 2.0 * c / length**2 * g
        return first, second


def _shape(length: float) -> tuple[Matrix, Matrix]:
    """Return B over x, ry, y, rx, and its derivative by the length, shape=(4, 4) each."""
    matrix, rate = np.zeros((4, 4)), np.zeros((4, 4))
    for start, sign in ((0, 1.0), (2, -1.0)):  # the slope of x is ry, that of y is -rx
        pair = slice(start, start + 2)
        matrix[pair, pair] = [[1.2 / length, -0.1 * sign], [-0.1 * sign, 2.0 * length / 15.0]]
        rate[pair, pair] = [[-1.2 / length**2, 0.0], [0.0, 2.0 / 15.0]]
    return matrix, rate
