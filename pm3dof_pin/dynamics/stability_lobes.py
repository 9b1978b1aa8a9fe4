r"""Stability of turning and milling against regenerative chatter: depth limits and lobes, of zeroth order.

The tool leaves a wave which its next pass, or next tooth, cuts after the period T. With the tool's receptance G in the
plane of the cut and the cutting force per depth in it, averaged over a revolution, motion at the angular frequency
omega persists at the depth a if

    det(1 - a (1 - exp(-i omega T)) B G) = 0,      so that a (1 - exp(-i omega T)) = c, with 1 / c an eigenvalue of B G.

A real depth needs a = |c|^2 / (2 Re c) with Re c > 0, and then omega T is the angle of 1 - c / a, up to whole turns,
one for each lobe. For turning, B is a product of two vectors, and a = -1 / (2 Re G) of the oriented receptance
(J. Tlusty and M. Polacek, 1963). For milling it is the mean of the directional coefficients between entry and exit
(Y. Altintas and E. Budak, Annals of the CIRP 44, 1995), which is accurate unless the cut is so brief that it hammers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import finite_array, frozen
from pm3dof_pin.dynamics.receptance import VibratingSystem
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.tolerances import SOLVED
from pm3dof_pin.typing import Array, Mask, Matrix, Vector

_TURNS = 300
"""Lobes that are followed; at speeds below them the depth limit is that of all speeds."""


@dataclass(frozen=True)
class Cutting:
    """A cut in the plane of two axes of the base, by which the tool is fed along the first.

    Raises:
        InvalidValueError: a number is not positive, or the width is not a part of the diameter.
    """

    kc: float  #: tangential cutting force per area of the chip [N/m^2]
    kr: float = 0.3  #: force normal to the cut surface, relative to the tangential one
    teeth: int = 0  #: number of teeth of the cutter; 0 for turning
    ae: float = 1.0  #: width of the cut of a cutter as part of its diameter, 1 for a slot
    ap: float | None = None  #: depth of the cut [m], if it is to be judged
    direction: Literal["up", "down"] = "down"  #: of milling; it makes no difference in a slot
    #: axes of the base; milling: feed and the normal to it; turning: normal of the cut surface and the cutting speed
    plane: Literal["xy", "yx", "xz", "zx", "yz", "zy"] = "xy"

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name in ("kc", "ae", "ap"):
            value = getattr(self, name)
            if value is not None and not 0.0 < value < np.inf:
                raise InvalidValueError(f"cutting: {name}", value, "a positive number")
        if self.ae > 1.0:
            raise InvalidValueError("cutting: ae", self.ae, "a part of the cutter's diameter, at most 1")
        if self.teeth < 0 or not 0.0 <= self.kr < np.inf:
            raise InvalidValueError("cutting: teeth, kr", f"{self.teeth}, {self.kr}", "numbers that are not negative")

    @property
    def coefficients(self) -> Matrix:
        """Mean force on the tool per depth and motion since the last pass, in the plane, shape=(2, 2) [N/m^2]."""
        if not self.teeth:
            return -self.kc * np.array([[self.kr, 0.0], [1.0, 0.0]])
        swept = math.acos(1.0 - 2.0 * self.ae)
        angles = np.array([0.0, swept] if self.direction == "up" else [math.pi - swept, math.pi])
        c, s, kr = np.cos(2.0 * angles), np.sin(2.0 * angles), self.kr
        integrals = 0.5 * np.array(
            [
                [c - 2.0 * kr * angles + kr * s, -s - 2.0 * angles + kr * c],
                [-s + 2.0 * angles + kr * c, -c - 2.0 * kr * angles - kr * s],
            ]
        )
        means: Matrix = self.kc * self.teeth / (4.0 * math.pi) * np.diff(integrals, axis=-1)[..., 0]
        return means


@dataclass(frozen=True, eq=False)
class StabilityLobes:
    """Depth limits of a cut at one pose."""

    cutting: Cutting  #: the cut
    depth_limit: float  #: below it the cut is stable at every speed; infinite if no depth chatters [m]
    chatter_frequency: float  #: frequency of chatter at that depth; NaN if there is none [Hz]
    speeds: Vector  #: spindle speeds, shape=(n,) [1/s]
    depths: Vector  #: depth limits at these speeds, shape=(n,) [m]

    @property
    def is_stable(self) -> Mask | None:
        """Whether the depth `ap` of the cut is stable at each speed, shape=(n,); None without a depth."""
        return None if self.cutting.ap is None else self.cutting.ap < self.depths


def stability_lobes(system: VibratingSystem, cutting: Cutting, speeds: ArrayLike) -> StabilityLobes:
    """Compute the depth limits of a cut at spindle speeds [1/s], and of all speeds.

    Raises:
        InvalidValueError: a speed is not positive.
        PM3DofError: the tool can move with all springs at rest, or there is none.
    """
    turns = finite_array("speeds", speeds, (np.size(speeds),))
    if not (turns > 0.0).all():
        raise InvalidValueError("speeds", float(turns.min()), "positive spindle speeds [1/s]")
    tool = system.rows([f"tool:{axis}" for axis in cutting.plane])
    frequencies = system.frequencies_around_modes()
    receptance = system.receptance(frequencies, tool, tool)
    depths, angles = _critical(cutting.coefficients @ receptance)
    best = np.unravel_index(depths.argmin(), depths.shape)
    limit = float(depths[best])
    return StabilityLobes(
        cutting=cutting,
        depth_limit=limit,
        chatter_frequency=float(frequencies[best[0]]) if np.isfinite(limit) else float("nan"),
        speeds=frozen(turns),
        depths=frozen(_envelope(frequencies, depths, angles, max(cutting.teeth, 1) * turns, limit)),
    )


def _critical(loops: Array) -> tuple[Matrix, Matrix]:
    """Return depths and angles omega T up to whole turns from B G, shape=(f, 2) each; inf where there is no chatter."""
    inverse = np.linalg.eigvals(loops)
    turned = np.abs(inverse[1:] - inverse[:-1, ::-1]).sum(axis=1) < np.abs(np.diff(inverse, axis=0)).sum(axis=1)
    swapped = np.append(False, np.cumsum(turned) % 2 == 1)  # each column follows one eigenvalue
    inverse = np.where(swapped[:, None], inverse[:, ::-1], inverse)
    inverse = np.where(np.abs(inverse) > SOLVED * np.abs(inverse).max(initial=0.0), inverse, np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        c = 1.0 / inverse  # zero for a vanishing eigenvalue, which no depth needs
        depths = np.where(c.real > 0.0, np.abs(c) ** 2 / (2.0 * c.real), np.inf)
        angles = -np.angle(1.0 - c / depths)
    return np.where(np.isfinite(depths), depths, np.inf), np.mod(angles, 2.0 * np.pi)


def _envelope(frequencies: Vector, depths: Matrix, angles: Matrix, passes: Vector, limit: float) -> Vector:
    """Return the least depth of all lobes at rates of passes or teeth [1/s]; the limit where no lobe is followed."""
    order = np.argsort(passes)
    rising, least = passes[order], np.full(len(passes), np.inf)
    slowest = 0.0
    for depth, angle in zip(depths.T, angles.T, strict=True):
        joined = np.isfinite(depth[:-1]) & np.isfinite(depth[1:]) & (np.abs(np.diff(angle)) < np.pi)
        first = np.flatnonzero(joined)
        if not len(first):
            continue
        for turn in range(_TURNS):
            rate = 2.0 * np.pi * frequencies / (angle + 2.0 * np.pi * turn + 1e-300)
            start, end = rate[first], rate[first + 1]
            if start.max() < rising[0]:
                break
            below = np.searchsorted(rising, np.minimum(start, end), side="left")
            counts = np.searchsorted(rising, np.maximum(start, end), side="right") - below
            k = np.repeat(np.arange(len(first)), counts)  # of each crossing of a piece of a lobe, the piece
            at = below[k] + np.arange(len(k)) - np.repeat(np.cumsum(counts) - counts, counts)
            with np.errstate(divide="ignore", invalid="ignore"):
                part = (rising[at] - start[k]) / (end - start)[k]
            np.fmin.at(least, at, depth[first[k]] + part * (depth[first[k] + 1] - depth[first[k]]))
        else:
            slowest = max(slowest, float(start.min()))
    envelope = np.empty(len(passes))
    envelope[order] = least
    envelope[passes < slowest] = limit
    return envelope
