"""Whether Numba can keep compiled kernels on disk, so that only the first run of all compiles them."""

from __future__ import annotations

import logging

import numba

_LOG = logging.getLogger(__name__)


def _probe() -> None:
    pass


def _can_keep() -> bool:
    try:
        numba.njit(cache=True)(_probe)  # looks for a folder, and compiles nothing yet
    except RuntimeError:
        _LOG.warning(
            "compiled kernels cannot be kept, as neither the package's folder nor the user's cache can be written; "
            "each run compiles them anew. The environment variable NUMBA_CACHE_DIR names another folder"
        )
        return False
    return True


KEEP = _can_keep()
"""What the argument `cache` of Numba's decorators has to be: with True they raise where no folder can be written."""
