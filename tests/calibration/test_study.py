"""A tiny study: resumed, reproduced, with the expected results."""

from __future__ import annotations

import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.figures.style import save_figure

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts" / "studies"))

import study
from study import FLOOR, METHODS, NONE, Record, StudyPlan, over_seeds, run_study, select
from study_pictures import excess_picture, tip_picture
from study_tables import study_tables

pytestmark = pytest.mark.usefixtures("small_networks")

PLAN = StudyPlan(seeds=(0,), counts=(9, 20), worlds=("everything", "geometry"), test_poses=8, shell_poses=4)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("study")


@pytest.fixture(scope="module")
def records(folder: Path) -> list[Record]:
    return run_study(PLAN, folder)


def test_everything_is_there(records: list[Record]) -> None:
    assert len(records) == 2 * 2 * (2 + 2 * len(METHODS))
    assert len(set(records)) == len(records)


def test_no_method_beats_the_best_commands(records: list[Record]) -> None:
    for record in records:
        floor = select(records, world=record.world, seed=record.seed, test=record.test, method=FLOOR)[0]
        assert record.tip[0] >= floor.tip[0] - 1e-6
        assert floor.excess == 0.0


def test_more_poses_are_better_and_all_better_than_none(records: list[Record]) -> None:
    for world in PLAN.worlds:
        here = select(records, world=world, test="held out")
        none = over_seeds(select(here, method=NONE), "excess")[0]
        for method in METHODS:
            few, many = (over_seeds(select(here, method=method, count=count), "excess")[0] for count in PLAN.counts)
            assert many < few < none


def test_hybrids_do_no_harm_to_geometry(records: list[Record]) -> None:
    for method in ("lm+nn", "lm+gp"):
        for record in select(records, world="geometry", method=method):
            same = {"world": "geometry", "seed": record.seed, "count": record.count, "test": record.test}
            parametric = select(records, **same, method="lm")[0]
            assert record.excess < parametric.excess + 0.5 * record.joint_noise


def test_an_interrupted_study_goes_on(folder: Path, records: list[Record], tmp_path: Path) -> None:
    """Finished machines are read, not recomputed, and the result is identical byte for byte."""
    shutil.copytree(folder, tmp_path / "study")
    (tmp_path / "study" / "geometry_000.json").unlink()
    seen: list[tuple[int, int]] = []
    again = run_study(PLAN, tmp_path / "study", progress=lambda done, total: seen.append((done, total)))
    assert seen == [(1, 2), (2, 2)]
    assert again == records
    for path in folder.iterdir():
        assert path.read_bytes() == (tmp_path / "study" / path.name).read_bytes()


def test_a_finished_study_runs_nothing(folder: Path, records: list[Record], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study, "run_job", lambda *_: pytest.fail("ran a finished job"))
    assert run_study(PLAN, folder) == records


def test_another_study_is_not_mixed_in(folder: Path, records: list[Record]) -> None:
    with pytest.raises(InvalidValueError, match="or another folder"):
        run_study(replace(PLAN, counts=(9, 30)), folder)


def test_tables_and_pictures(records: list[Record], tmp_path: Path) -> None:
    text = study_tables(PLAN, records)
    assert text.count("### World: ") == 4
    mean = 1e6 * np.mean([r.excess for r in select(records, world="geometry", test="held out", count=9, method="gp")])
    assert f" {mean:.1f} (" in text
    assert "| redundant parallel module, max | 0.192 | 0.075 | 0.014 | 13.7 |" in text
    for name, picture in (("excess", excess_picture), ("tip", tip_picture)):
        path = save_figure(picture(PLAN, records), tmp_path / f"{name}.png")
        assert path.read_bytes().startswith(b"\x89PNG")
