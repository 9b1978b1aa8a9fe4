"""Laws of springs that are contacts: Hertz's contacts under preload or with play, and progressive springs.

A law gives the force f(r) of a spring deflected by r in any of its directions; its stiffness in the description, k, is
that of small vibrations about the state at which it is linearised:

- `preload` P: two opposed contacts, each with the force P (1 +- r / r0)^n, which vanishes where it opens at r = r0 =
  2 n P / k. From the force 2^n P on, 2.83 P for balls, only one of them bears.
- `play` c: no force until r = c, then one contact, `load` ((r - c) / r0)^n with r0 = n `load` / k: k is its stiffness
  under that load. Inside the play a millionth of k stands for what centres the parts, so that their place is defined.
- `doubles_at` s: progressive, the stiffness k (1 + r^2 / s^2).

The exponent n is 3/2 for balls, which touch in points (H. Hertz, 1882), 10/9 for rollers (G. Lundberg, 1939), and 1 for
contacts of constant stiffness.
"""

from __future__ import annotations

import math
from typing import Annotated

import msgspec
import numpy as np

from pm3dof_pin.description.schema import Positive
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.typing import Matrix, Vector

SEAT = 1e-6
"""Stiffness within an open play, relative to that of the closed contact."""


class ContactLaw(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How the stiffness of a spring depends on its deflection; exactly one of preload, play and doubles_at is given.

    Raises:
        InvalidValueError: none or several of them are given, a number is not positive and finite, the exponent is not
            between 1 and 3, or a contact with play and an exponent above 1 has no load at which it is linearised.
    """

    preload: Positive | None = None  #: P, force between the parts without a load [N]
    play: Positive | None = None  #: c, how far they move to either side without a force [m]
    doubles_at: Positive | None = None  #: s, deflection at which the stiffness is twice that at rest [m]
    exponent: Annotated[float, msgspec.Meta(ge=1.0, le=3.0)] = 1.5  #: n, of the force by the approach of two parts
    load: Positive | None = None  #: load at which a contact with play has its declared stiffness [N]

    def __post_init__(self) -> None:
        """Check the numbers."""
        given = [name for name in ("preload", "play", "doubles_at") if getattr(self, name) is not None]
        if len(given) != 1:
            raise InvalidValueError("law", ", ".join(given) or "empty", "one of preload, play, doubles_at")
        for name in (*given, "load"):
            value = getattr(self, name)
            if value is not None and not 0.0 < value < np.inf:
                raise InvalidValueError(f"law: {name}", value, "a positive, finite number")
        if not 1.0 <= self.exponent <= 3.0:
            raise InvalidValueError("law: exponent", self.exponent, "a number from 1 to 3")
        if self.play is not None and self.exponent > 1.0 and self.load is None:
            raise InvalidValueError("law: load", None, "the force [N] under which the contact has its stiffness")
        if self.load is not None and self.play is None:
            raise InvalidValueError("law: load", self.load, "none, except with play")

    def opens_at(self, stiffness: float) -> float:
        """Return the deflection at which one of the preloaded parts loses contact [m]; infinite without a preload."""
        return np.inf if self.preload is None else 2.0 * self.exponent * self.preload / stiffness

    def force(self, stiffness: float, deflection: float, seat: float = SEAT) -> tuple[float, float]:
        """Return the force and its derivative at a deflection r >= 0 [N, N/m] of a spring of a declared stiffness."""
        n, r, k = self.exponent, deflection, stiffness
        if self.doubles_at is not None:
            return k * r * (1.0 + r**2 / (3.0 * self.doubles_at**2)), k * (1.0 + r**2 / self.doubles_at**2)
        if self.preload is not None:
            opening = self.opens_at(k)
            near, far = 1.0 + r / opening, max(0.0, 1.0 - r / opening)
            tangent = near ** (n - 1.0) + (far ** (n - 1.0) if far > 0.0 else 0.0)
            return self.preload * (near**n - far**n), 0.5 * k * tangent
        assert self.play is not None
        depth, soft = r - self.play, seat * k
        if depth <= 0.0:
            return soft * r, soft
        if n == 1.0 or self.load is None:
            return k * depth + soft * r, k + soft
        unit = n * self.load / k
        return self.load * (depth / unit) ** n + soft * r, k * (depth / unit) ** (n - 1.0) + soft

    def derivatives(self, stiffness: float, deflection: Vector, seat: float = SEAT) -> tuple[Vector, Matrix]:
        """Return the force and its derivative in several directions, which depend on the length of the deflection.

        Args:
            stiffness: k, declared, the same in all directions [N/m].
            deflection: d, shape=(n,) [m].
            seat: stiffness within an open play, relative to k.
        """
        distance = float(np.linalg.norm(deflection))
        force, tangent = self.force(stiffness, distance, seat)
        if distance == 0.0:
            return np.zeros_like(deflection), tangent * np.eye(len(deflection))
        along = deflection / distance
        secant = force / distance
        return force * along, secant * np.eye(len(along)) + (tangent - secant) * np.outer(along, along)

    def state(self, stiffness: float, deflection: float) -> str:
        """Describe a contact at a deflection r >= 0: preloaded, one-sided, closed, open or progressive."""
        if self.doubles_at is not None:
            return "progressive"
        if self.preload is not None:
            return "preloaded" if deflection < self.opens_at(stiffness) else "one-sided"
        assert self.play is not None
        return "open" if math.isclose(deflection, self.play, rel_tol=1e-9) or deflection < self.play else "closed"
