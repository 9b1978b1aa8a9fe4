"""Timing of some work: the least of several tries, the one least disturbed by other processes."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping


def least_time(work: Callable[[], object], tries: int = 5, clock: Callable[[], float] = time.perf_counter) -> float:
    """Return the least time of some work by a clock of the module `time` [s]; the first try may compile."""
    times = []
    for _ in range(tries):
        start = clock()
        work()
        times.append(clock() - start)
    return min(times)


def least_times(work: Mapping[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Return the least time of each piece of work [s], done in turn, each directly after a run that is not counted.

    Otherwise the work before decides whether memory for results is already there: half the time of a large batch.
    """
    least = dict.fromkeys(work, float("inf"))
    for _ in range(rounds):
        for name, run in work.items():
            run()
            least[name] = min(least[name], least_time(run, 1))
    return least
