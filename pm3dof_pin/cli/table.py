"""`pm3dof table-8-3`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pm3dof_pin.chapter import table_8_3 as table
from pm3dof_pin.chapter.table_8_3 import TableRow
from pm3dof_pin.cli.map_options import EngineOption
from pm3dof_pin.cli.options import THE_TRIPOD, Config, Json, MachineOptions
from pm3dof_pin.cli.output import print_result, table_lines

_NEAR = 10  # units of the last printed digit within which numbers agree


def table_8_3(as_json: Json = False, config: Config = None, engine: EngineOption = "program") -> None:
    """Print Table 8.3, published and computed; with --engine pinocchio, from the URDF's Jacobians."""
    which = MachineOptions(robot=THE_TRIPOD, config=config)
    robot = which.load() if engine == "pinocchio" else None
    rows = table.table_8_3(which.tripod(), robot=robot)
    result, lines = described(rows)
    print_result({"robot": THE_TRIPOD} | result, lines, as_json=as_json)


def described(rows: Sequence[TableRow]) -> tuple[dict[str, Any], list[str]]:
    """Return the rows as data for JSON, and as a sentence and a text table with remarks as footnotes."""
    keys = ("axis", "statistic", "published", "computed", "relative_difference", "last_digit_difference", "remark")
    data = [{key: getattr(row, key) for key in keys} for row in rows]
    remarked = [row for row in rows if row.remark]
    cells = [
        [
            *(row.axis, row.statistic, f"{row.published:.4e}", f"{row.computed:.4e}"),
            *(f"{row.relative_difference:+.1e}", f"[{remarked.index(row) + 1}]" if row.remark else _verdict(row)),
        ]
        for row in rows
    ]
    header = ["axis", "statistic", "published", "computed", "difference", "to five digits"]
    notes = [
        f"[{number}] {row.axis} {row.statistic}: the printed number {row.remark}"
        for number, row in enumerate(remarked, start=1)
    ]
    return {"rows": data}, [_sentence(rows), *table_lines(header, cells), *notes]


def _sentence(rows: Sequence[TableRow]) -> str:
    """Say how many of the published numbers were computed again."""
    plain = [row for row in rows if not row.remark]
    exact = sum(row.last_digit_difference == 0 for row in plain)
    near = [off for row in plain if 0 < (off := abs(row.last_digit_difference)) < _NEAR]
    parts = [f"{exact} of the {len(rows)} numbers printed are computed to all five digits"]
    parts += [f"{len(near)} within {max(near)} of the last"] if near else []
    if differ := len(plain) - exact - len(near):
        parts.append(f"{differ} differ")
    if noted := len(rows) - len(plain):
        parts.append(f"{noted} is in doubt (below)" if noted == 1 else f"{noted} are in doubt (below)")
    return f"{', '.join(parts)}."


def _verdict(row: TableRow) -> str:
    difference = row.last_digit_difference
    if difference == 0:
        return "as printed"
    return f"{difference:+d} in the last" if abs(difference) < _NEAR else "differs"
