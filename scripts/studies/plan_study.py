"""Value of poses for each calibration method: a table of strategies, printed and in results/.

Ten simulated machines, five strategies, four methods, 10 to 40 poses: some five minutes on one processor. An
interrupted study continues where it stopped: finished machines are kept in plan_study/ of the output folder.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

# the matrices are small: threads inside each process would only get in each other's way
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from study import StudyPlan, run_study
from study_tables import strategies_table

from pm3dof_pin.cli.output import progress_bar
from pm3dof_pin.files import write_text_atomically

RESULTS = Path(__file__).resolve().parents[2] / "results"
PLAN = StudyPlan(
    counts=(10, 20, 40),
    worlds=("everything",),
    strategies=("random", "d-optimal", "space-filling", "process-variance", "least-sensitive"),
    methods=("lm", "nn", "gp", "lm+gp"),
    test_poses=60,
    shell_poses=4,
)


def main(plan: StudyPlan = PLAN, out: Path = RESULTS, workers: int = 1) -> None:
    with progress_bar("machines") as progress:
        records = run_study(plan, out / "plan_study", workers=workers, progress=progress)
    text = strategies_table(plan, records)
    print(text)
    print(f"wrote {write_text_atomically(out / 'plan_study.md', text)}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder to write to")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="number of processes")
    arguments = parser.parse_args()
    main(out=arguments.out, workers=arguments.workers)
