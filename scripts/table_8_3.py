"""Table 8.3: published and computed numbers side by side, on the terminal and in results/table_8_3.csv."""

from __future__ import annotations

import csv
import io
from pathlib import Path

from pm3dof_pin.chapter.table_8_3 import table_8_3
from pm3dof_pin.cli.table import rows_as_data, rows_as_lines
from pm3dof_pin.files import write_text_atomically

RESULTS = Path(__file__).resolve().parents[1] / "results"


def main() -> None:
    rows = table_8_3()
    print("\n".join(rows_as_lines(rows)))
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, list(rows_as_data(rows)[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows_as_data(rows))
    print(f"wrote {write_text_atomically(RESULTS / 'table_8_3.csv', text.getvalue())}")


if __name__ == "__main__":
    main()
