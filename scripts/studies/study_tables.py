"""The study in tables, as Markdown: excess joint errors, tip errors, and published figures for comparison."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from study import FLOOR, NONE, TESTS, Record, StudyPlan, over_seeds, select

from pm3dof_pin.calibration.fit import METHODS

PUBLISHED = (
    ("redundant parallel module, max", 0.192, 0.075, 0.014, "doi 10.1177/0954405420911299; interpolated residuals"),
    ("five-bar, max", 1.548, None, 0.045, "filter and network"),
    ("serial arm", 3.158, 0.406, 0.0685, "PLOS ONE 0331136; network on the residuals"),
)
"""Published errors [mm]: machine, before, after parametric and after hybrid calibration, source."""

_MICROMETRES = 1e6


def study_tables(plan: StudyPlan, records: Sequence[Record]) -> str:
    """Return all tables of a study.

    Args:
        plan: its cases.
        records: the results.
    """
    parts = []
    for world in plan.worlds:
        for test in TESTS:
            parts += [f"### World: {world}, {test} poses\n", _methods_table(plan, records, world, test)]
    parts += ["### Before and after, with published figures\n", _published_table(plan, records)]
    return "\n".join(parts)


def strategies_table(plan: StudyPlan, records: Sequence[Record]) -> str:
    """Return the excess joint errors at held-out poses by method, number of poses and strategy.

    Args:
        plan: the cases of the study.
        records: the results.
    """
    here = select(records, world=plan.worlds[0], test=TESTS[0])
    rows = []
    for method in plan.methods:
        for count in plan.counts:
            cells = []
            for strategy in plan.strategies:
                chosen = select(here, method=method, count=count, strategy=strategy)
                values = _MICROMETRES * np.array([record.excess for record in chosen])
                error = values.std(ddof=1) / np.sqrt(len(values)) if len(values) > 1 else np.nan
                cells.append(f"{values.mean():.1f} ± {error:.1f}")
            rows.append([method, str(count), *cells])
    return _markdown(["method", "poses", *plan.strategies], rows)


def _methods_table(plan: StudyPlan, records: Sequence[Record], world: str, test: str) -> str:
    here = select(records, world=world, test=test)
    header = ["poses", "", *METHODS]
    rows = []
    for count in plan.counts:
        excess, tip, energy = [], [], []
        for method in METHODS:
            chosen = select(here, count=count, method=method)
            mean, least, most = (_MICROMETRES * value for value in over_seeds(chosen, "excess"))
            excess.append(f"{mean:.1f} ({least:.1f} .. {most:.1f})")
            for quantity, cells in (("tip", tip), ("energy", energy)):
                values = [_MICROMETRES * over_seeds(chosen, quantity, index)[0] for index in range(3)]
                cells.append(" / ".join(f"{value:.0f}" for value in values))
        rows += [[str(count), "excess joint error", *excess], ["", "tip: mean / 95 % / max", *tip]]
        rows += [["", "E of (8.15): mean / 95 % / max", *energy]]
    return _markdown(header, rows) + "\n" + _reference_line(here)


def _reference_line(records: Sequence[Record]) -> str:
    none, floor = select(records, method=NONE), select(records, method=FLOOR)
    tips = [
        " / ".join(f"{_MICROMETRES * over_seeds(chosen, 'tip', index)[0]:.0f}" for index in range(3))
        for chosen in (none, floor)
    ]
    mean, least, most = (_MICROMETRES * value for value in over_seeds(none, "excess"))
    noise, joint_noise = (_MICROMETRES * over_seeds(none, name)[0] for name in ("noise", "joint_noise"))
    return (
        f"Without correction: excess joint error {mean:.0f} ({least:.0f} .. {most:.0f}) µm, tip {tips[0]} µm. With the "
        f"best commands (floor): tip {tips[1]} µm. One measurement's noise: tip {noise:.1f} µm, joints "
        f"{joint_noise:.1f} µm.\n"
    )


def _published_table(plan: StudyPlan, records: Sequence[Record]) -> str:
    count = max(plan.counts)
    rows = []
    for test in TESTS:
        here = select(records, world=plan.worlds[0], test=test)
        for title, quantity, index in (("tip error, max", "tip", 2), ("excess joint error, rms", "excess", None)):
            before = 1e3 * over_seeds(select(here, method=NONE), quantity, index)[0]
            after = {
                method: 1e3 * over_seeds(select(here, method=method, count=count), quantity, index)[0]
                for method in METHODS
            }
            name = f"this study, {count} poses, {test}: {title}"
            rows.append(_ratios(name, before, after["lm"], min(after["lm+nn"], after["lm+gp"]), "mean over the seeds"))
    rows += [_ratios(*entry) for entry in PUBLISHED]
    return _markdown(["", "before [mm]", "parametric [mm]", "hybrid [mm]", "before / after", "remark"], rows)


def _ratios(name: str, before: float, parametric: float | None, hybrid: float, remark: str) -> list[str]:
    middle = "" if parametric is None else f"{parametric:.4g}"
    return [name, f"{before:.4g}", middle, f"{hybrid:.4g}", f"{before / hybrid:.1f}", remark]


def _markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)
