"""Programs: recording, compiling, loading from the cache, running, on one thread and on two.

Recording, compiling and loading are processor time; times of running are the least of many short runs, taken in turn,
so that ratios hold on a busy machine too; but two threads need two free processors.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.quantities import COMPLIANCE
from pm3dof_pin.elastic.traced import elastic_program, traced_program
from pm3dof_pin.programs import cache, llvm

POSES = 16384
FEW = 100
ROUNDS = 40

T = TypeVar("T")


def timed(run: Callable[[], T], clock: Callable[[], float] = time.process_time) -> tuple[float, T]:
    """Return the time of a run [s], and its result."""
    start = clock()
    result = run()
    return clock() - start, result


def main() -> None:
    processor = llvm.target()
    print(f"{processor.name}: {processor.lanes} poses at once, {os.cpu_count()} processors")
    for robot in ("pm3dof", "hexapod", "three_rps"):
        model = ElasticModel.load(robot)
        frame = model.rigid.tool_frame
        trace, program = timed(lambda: traced_program(model, frame, "compliance", COMPLIANCE.traced, closed=True))  # noqa: B023
        with tempfile.TemporaryDirectory() as folder:
            os.environ["PM3DOF_CACHE_DIR"] = folder
            first, _ = timed(lambda: cache.compiled(cache.stored(robot, lambda: program)))  # noqa: B023
            careful, _ = timed(lambda: llvm.object_code(program, processor.lanes, optimized=True))  # noqa: B023
            second, compiled = timed(lambda: cache.compiled(cache.stored(robot, lambda: program)))  # noqa: B023
            parameters = elastic_program(model, frame, "compliance", COMPLIANCE.traced, closed=True).parameters
        poses = np.tile(model.rigid.home.q, (POSES, 1))
        out = np.empty((POSES, len(program.results)))
        times = {1: np.inf, 2: np.inf, "one pose": np.inf}
        for _ in range(ROUNDS):
            for threads in (1, 2):
                again, _ = timed(lambda: compiled(poses, parameters, out, threads=threads), time.perf_counter)  # noqa: B023
                times[threads] = min(times[threads], again)
            again, _ = timed(
                lambda: [compiled(poses[:1], parameters, out[:1]) for _ in range(FEW)],  # noqa: B023
                time.perf_counter,
            )
            times["one pose"] = min(times["one pose"], again / FEW)
        print(f"{robot}: {len(program)} operations")
        print(
            f"  recorded with its samples in {trace:.2f} s, compiled in {first:.2f} s, optimised in {careful:.2f} s",
            end="",
        )
        print(f" ({1e6 * careful / len(program):.0f} us an operation), loaded in {1e3 * second:.1f} ms")
        each = times[1] / POSES
        print(f"  {1e6 * each:.3f} us/pose, {1e12 * each / len(program):.0f} ps an operation", end="")
        print(f"; two threads {times[1] / times[2]:.2f} times faster; one pose alone {1e6 * times['one pose']:.1f} us")


if __name__ == "__main__":
    main()
