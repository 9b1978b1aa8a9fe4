"""The calibration study: docs/tables/calibration_study.txt and two pictures for the docs.

Thirty simulated machines, six methods, 6 to 100 poses; some ten minutes on two processors. An interrupted study goes on
where it stopped: finished machines are kept in results/calibration_study.
"""

from __future__ import annotations

import os
from pathlib import Path

# the matrices are small: threads inside each process would only get in each other's way
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from study import StudyPlan, run_study
from study_pictures import excess_picture, tip_picture
from study_tables import study_tables

from pm3dof_pin.cli.progress import progress_bar
from pm3dof_pin.figures.style import save_figure
from pm3dof_pin.files import write_text_atomically

ROOT = Path(__file__).resolve().parents[2]


def main(plan: StudyPlan | None = None, results: Path = ROOT / "results", docs: Path = ROOT / "docs") -> None:
    wanted = plan or StudyPlan()
    with progress_bar("machines") as progress:
        records = run_study(wanted, results / "calibration_study", workers=os.cpu_count() or 1, progress=progress)
    for path in (
        write_text_atomically(docs / "tables" / "calibration_study.txt", study_tables(wanted, records)),
        save_figure(excess_picture(wanted, records), docs / "pictures" / "calibration_study_excess.png"),
        save_figure(tip_picture(wanted, records), docs / "pictures" / "calibration_study_tip.png"),
    ):
        print(f"wrote {path}")


if __name__ == "__main__":
    main()
