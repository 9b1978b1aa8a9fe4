"""Wrong measurement files are refused with their cause, doubted, or as good as correct ones: a few of the script's."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

import pytest

_SPEC = importlib.util.spec_from_file_location("wrong_measurements", Path(__file__).with_name("wrong_measurements.py"))
assert _SPEC is not None
assert _SPEC.loader is not None
script: Any = importlib.util.module_from_spec(_SPEC)
sys.modules[_SPEC.name] = script  # where its dataclasses look up their module
_SPEC.loader.exec_module(script)

pytestmark = pytest.mark.usefixtures("few_folds")

# of those that take a whole calibration to judge a few for each robot, tests/calibration/test_causes.py has others;
# of the others all
WHOLE = {
    "pm3dof": ("one drive constant",),
    "hexapod": ("seven rows below", "x in millimetres"),
    "five_bar": ("centimetres", "half stale"),
}


@pytest.fixture(scope="module")
def goods() -> dict[str, tuple[Any, float]]:
    return {}


@pytest.mark.parametrize(("robot", "name"), [(robot, name) for robot, names in WHOLE.items() for name in names])
def test_the_cause_is_named(robot: str, name: str, goods: dict[str, tuple[Any, float]], tmp_path: Path) -> None:
    if robot not in goods:
        goods[robot] = (script.Good.of(robot, 16), 0.0)
    good, best = goods[robot]
    found = script.outcome(good, script.WRONG[name].spoil(good), tmp_path)
    assert found.kind == "refused"
    assert script.verdict(script.WRONG[name], found, best) == "", found.words


def test_a_bad_text_is_refused_at_once(tmp_path: Path) -> None:
    """Everything that the reader itself refuses, as listed when this was written."""
    good = script.Good.of("pm3dof", 6)
    for name in script.REFUSED_BY_THE_READER:
        found = script.outcome(good, script.WRONG[name].spoil(good), tmp_path)
        assert found.kind == "refused", name
        assert script.verdict(script.WRONG[name], found, 0.0) == "", (name, found.words)


def test_a_right_file_in_another_form_stays_right(tmp_path: Path) -> None:
    good = script.Good.of("pm3dof", 12)
    best = script.outcome(good, good.table, tmp_path)
    assert best.kind == "accepted", best.words
    text = script.as_text(good.table)
    strange = "\ufeff" + text.replace(",", ", ").replace("\n", "\r\n\r\n")
    assert script.outcome(good, strange, tmp_path).result == best.result
