"""Hertz's contact of two curved steel surfaces, and contacts of machine elements made of many of them.

Force F and approach d of two bodies that touch in a point satisfy F = C d^(3/2). With the curvatures of both in two
directions, their sum S and the axes ratio a of the ellipse in which they touch, which solves

    ((a^2 + 1) E - 2 K) / ((a^2 - 1) E) = (difference of the curvatures) / S,

K and E being the complete elliptic integrals of the modulus sqrt(1 - 1/a^2),

    d = (2 K / pi) (pi / (2 a^2 E))^(1/3) (3 F / (2 S E*))^(2/3) S / 2,    1 / E* = 2 (1 - nu^2) / E

(T. Harris and M. Kotzalas, Essential Concepts of Bearing Technology, 5th edition, 2006, chapter 6; K. Johnson, Contact
Mechanics, 1985, chapter 4).
"""

from __future__ import annotations

import math

MODULUS = 208e9
"""Young's modulus of bearing steel [N/m^2]."""

POISSON = 0.3
"""Poisson's ratio of bearing steel."""

_EFFECTIVE = MODULUS / (2.0 * (1.0 - POISSON**2))
_ROUND = 1e-9  # difference of curvatures, relative to their sum, of a circular contact
_MAX_RATIO = 1e4


def point_contact(curvatures: tuple[float, float]) -> float:
    """Return C of F = C d^(3/2) [N/m^1.5] from the sums of both bodies' curvatures in two normal directions [1/m].

    Concave surfaces have negative curvatures; both sums must be positive.

    Raises:
        ValueError: a sum of curvatures is not positive.
    """
    from scipy.optimize import brentq  # for few machines, and slow to import
    from scipy.special import ellipe, ellipk

    small, large = sorted(curvatures)
    if not small > 0.0:
        raise ValueError(f"curvatures {curvatures}: expected positive sums")
    total, difference = large + small, (large - small) / (large + small)
    ratio, first, second = 1.0, 0.5 * math.pi, 0.5 * math.pi
    if difference > _ROUND:

        def excess(axes: float) -> float:
            k, e = ellipk(1.0 - axes**-2), ellipe(1.0 - axes**-2)
            return float(((axes**2 + 1.0) * e - 2.0 * k) / ((axes**2 - 1.0) * e) - difference)

        ratio = float(brentq(excess, 1.0 + 1e-6, _MAX_RATIO, xtol=1e-12))
        first, second = float(ellipk(1.0 - ratio**-2)), float(ellipe(1.0 - ratio**-2))
    scale = (2.0 * first / math.pi) * (math.pi / (2.0 * ratio**2 * second)) ** (1.0 / 3.0)
    approach = scale * (3.0 / (2.0 * total * _EFFECTIVE)) ** (2.0 / 3.0) * total / 2.0  # at 1 N
    return math.pow(approach, -1.5)


def in_series(first: float, second: float) -> float:
    """Return C of two point contacts that bear the same force, such as a ball between two races [N/m^1.5]."""
    return math.pow(math.pow(first, -2.0 / 3.0) + math.pow(second, -2.0 / 3.0), -1.5)


def ball_between_races(ball: float, conformity: float, inner: float, outer: float) -> float:
    """Return C of a ball between two grooves [N/m^1.5].

    Args:
        ball: diameter of the ball [m].
        conformity: radius of both grooves relative to the ball's diameter, above 1/2.
        inner: curvature of the inner groove along itself, positive if convex [1/m].
        outer: curvature of the outer groove along itself, negative if it surrounds the ball's path [1/m].
    """
    across = 2.0 / ball - 1.0 / (conformity * ball)
    return in_series(point_contact((across, 2.0 / ball + inner)), point_contact((across, 2.0 / ball + outer)))
