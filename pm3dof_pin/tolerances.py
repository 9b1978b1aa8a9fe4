"""The tolerances of the package, relative to the greatest number of their kind unless a unit is given, with reasons."""

from __future__ import annotations

ROUNDING = 1e-12
"""What is smaller is rounding: a few hundred operations in double precision lose less than four of sixteen digits."""

SOLVED = 1e-9
"""What a solved system of equations may leave: loops closed to 1e-12 of the machine, and a condition number of 1000."""

MASSLESS = 1e-13
"""Motions of less 1 / omega^2 than this are massless: the squares of frequencies a thousand times ROUNDING's."""
