"""Stated uncertainty of calibrations, on a few machines written without the package: a small version of the study."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts" / "studies"))

from calibration_coverage import one_linear, table

MACHINES = range(3000, 3005)


@pytest.mark.parametrize("setup", ["base", "heights"])
def test_bounds_hold_parameters_are_near_and_nothing_gets_worse(setup: str) -> None:
    found = [one_linear(("tripod", seed, 1.0, setup, "lm"), 30) for seed in MACHINES]
    column = {name: np.array([row[name] for row in found]) for name in found[0] if name.endswith(("um", "in", "gma"))}
    # poses of a machine share its parameters' errors: one of five machines may be off
    assert np.mean(column["within"]) > 0.75
    assert not column["beyond_4_sigma"].any()
    assert np.all(column["after_um"] < column["before_um"])
    said, true = (np.sqrt(np.mean(column[f"excess_{name}_um"] ** 2)) for name in ("said", "true"))
    assert said == pytest.approx(true, rel=0.4)


def test_the_table_has_a_row_for_each_way_of_measuring(tmp_path: Path) -> None:
    rows = [one_linear(("tripod", 3000, 1.0, setup, "lm"), 30) for setup in ("tracker", "targets")] * 2
    path = tmp_path / "coverage.csv"
    path.write_text("\n".join([",".join(rows[0]), *(",".join(map(str, row.values())) for row in rows)]) + "\n")
    lines = table(path).splitlines()
    assert [line.split(" | ")[:3] for line in lines[2:]] == [
        ["| tripod", setup, "everything"] for setup in ("tracker", "targets")
    ]
