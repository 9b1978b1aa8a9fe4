"""Tables 8.1 and 8.2: the numbers of the machine with their origin, printed and as CSV."""

from __future__ import annotations

import argparse
from pathlib import Path

from pm3dof_pin.cli.output import table_lines
from pm3dof_pin.description.parameters import TripodParameters
from pm3dof_pin.files import csv_text, write_text_atomically

RESULTS = Path(__file__).resolve().parents[1] / "results"
SECTIONS = {"8.1": ("geometry", "joints"), "8.2": ("inertia",)}
HEADER = ("quantity", "symbol", "value", "unit", "origin", "source")


def main(out: Path = RESULTS) -> None:
    quantities = TripodParameters.load().quantities
    for table, sections in SECTIONS.items():
        rows = []
        for key, quantity in quantities.items():
            section, name = key.split(".")
            if section in sections:
                numbers = quantity.value if isinstance(quantity.value, tuple) else (quantity.value,)
                value = ", ".join(f"{number:g}" for number in numbers)
                rows.append([name, quantity.symbol, value, quantity.unit, quantity.status, quantity.source])
        print(f"\nTable {table}")
        print("\n".join(table_lines(HEADER[:5], [row[:5] for row in rows])))
        path = out / f"table_{table.replace('.', '_')}.csv"
        print(f"wrote {write_text_atomically(path, csv_text([HEADER, *rows]))}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder to write to")
    main(**vars(parser.parse_args()))
