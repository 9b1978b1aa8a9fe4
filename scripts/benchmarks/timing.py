"""How long something takes: the least of several tries, which others on the machine disturbed least."""

from __future__ import annotations

import time
from collections.abc import Callable


def least_time(work: Callable[[], object], tries: int = 5, clock: Callable[[], float] = time.perf_counter) -> float:
    """Return the least time of some work by a clock of the module `time` [s]; the first try may compile."""
    times = []
    for _ in range(tries):
        start = clock()
        work()
        times.append(clock() - start)
    return min(times)
