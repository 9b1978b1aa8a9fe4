"""The tolerances of the package, relative to the greatest number of their kind unless a unit is given, with reasons."""

from __future__ import annotations

ROUNDING = 1e-12
"""What is smaller is rounding: a few hundred operations in double precision lose less than four of sixteen digits."""

SOLVED = 1e-9
"""What a solved system of equations may leave: loops closed to 1e-12 of the machine, and a condition number of 1000."""

SAME = SOLVED
"""Numbers that differ by less are the same [m, rad, relative]: solved systems leave this, files have fewer digits."""

SIGN = 1e-9
"""Determinants up to this, relative to the usual one, have no sign: their factors are singular values down to 1e-3."""

LAST_DIGITS = 1e-15
"""Numbers of size one that differ by less are the same but for the last digits of sines, cosines and decimal files."""

MASSLESS = 1e-13
"""Motions of less 1 / omega^2 than this are massless: the squares of frequencies a thousand times ROUNDING's."""

CLOSED = 1e-12
"""Largest error of closed loops [m, rad]: Newton's method ends at 1e-16 to 1e-15 for positions of about a metre."""

MAX_IMPRECISION = 1e-4
"""Largest closure error that counts as imprecision of a file [characteristic lengths, rad]: 10 micrometres of 0.1 m."""

MIN_LEVER = 3e-5
"""Shortest lever arm of a joint [characteristic lengths]: shorter ones are imprecisions of frames, and move nothing."""

IMPRECISION_MARGIN = 3.0
"""Ratio of the closure tolerance of an imprecise robot to what is left at home, for poses that close less well."""

RANK_GAP = 1e3
"""Ratio by which singular values fall where a rank is decided: rounding of files and of lengths leaves 1e4 and more."""

RANK_CEILING = 1e-6
"""Singular values above this, relative to the greatest, count: so near to singular poses no machine is precise."""

IMPRECISE_AXES = 1e-5
"""The same for robots whose closures are so nearly redundant at home: axes given by six digits are parallel to 1e-6."""

RANK_PER_ERROR = 30.0
"""Relative singular values left of redundant closures by imprecise frames, by their relative errors: lever arms."""
