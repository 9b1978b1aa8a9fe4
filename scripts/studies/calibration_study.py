"""The calibration study: a table and two pictures, written to results/ or, with --docs, where the pages show them.

Thirty simulated machines, five methods, 6 to 100 poses; some ten minutes on two processors. An interrupted study
continues where it stopped: finished machines are kept in calibration_study/ of the output folder.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

# the matrices are small: threads inside each process would only get in each other's way
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from study import StudyPlan, run_study
from study_pictures import excess_picture, tip_picture
from study_tables import study_tables

from pm3dof_pin.cli.output import progress_bar
from pm3dof_pin.figures.style import save_figure
from pm3dof_pin.files import write_text_atomically

ROOT = Path(__file__).resolve().parents[2]


def main(
    plan: StudyPlan | None = None, out: Path = ROOT / "results", docs: Path | None = None, workers: int = 1
) -> None:
    wanted = plan or StudyPlan()
    with progress_bar("machines") as progress:
        records = run_study(wanted, out / "calibration_study", workers=workers, progress=progress)
    tables, pictures = (out, out) if docs is None else (docs / "tables", docs / "pictures")
    for path in (
        write_text_atomically(tables / "calibration_study.txt", study_tables(wanted, records)),
        save_figure(excess_picture(wanted, records), pictures / "calibration_study_excess.png"),
        save_figure(tip_picture(wanted, records), pictures / "calibration_study_tip.png"),
    ):
        print(f"wrote {path}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "results", help="folder to write to")
    parser.add_argument("--docs", action="store_true", help="write table and pictures over those of the documentation")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="number of processes")
    arguments = parser.parse_args()
    main(out=arguments.out, docs=ROOT / "docs" if arguments.docs else None, workers=arguments.workers)
