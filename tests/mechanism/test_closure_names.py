"""Closures between the same frames: each has a name of its own, and a distance is held once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import pm3dof_pin as pm
from pm3dof_pin.description.closures import LoopClosure, uniquely_named
from pm3dof_pin.description.yaml_file import read_mapping
from pm3dof_pin.exceptions import DescriptionError

FIVE_BAR = Path(__file__).resolve().parents[1] / "machines" / "five_bar" / "five_bar.urdf"


def _saved(folder: Path, urdf: Path, more: dict[str, Any]) -> Path:
    """Write a robot with closures added to its own."""
    path, entries = folder / urdf.name, read_mapping(urdf.with_suffix(".closures.yaml"))
    for key, added in more.items():
        entries[key] = [*entries.get(key, ()), *added]
    path.write_text(urdf.read_text())
    path.with_suffix(".closures.yaml").write_text("\n".join(f"{key}: {value}" for key, value in entries.items()))
    return path


def test_names_are_unique_whatever_frames_are_called() -> None:
    """Hyphens and digits in the names of frames make no two names alike, and naming again changes nothing."""
    pairs = [("a", "b"), ("a", "b"), ("a", "b-2"), ("a-b", "2"), ("a", "b")]
    named = uniquely_named(LoopClosure(a, b, "3d") for a, b in pairs)
    assert [loop.name for loop in named] == ["a-b", "a-b-2", "a-b-2-2", "a-b-2-3", "a-b-3"]
    assert uniquely_named(named) == named


def test_both_swings_of_a_pair_of_frames_are_reported(tmp_path: Path, answer: Any) -> None:
    """A ball and a hinge between the same frames of a planar machine each have a swing, which is zero."""
    more = {"closed_loop": [["left_tip", "right_tip"]], "type": ["hinge"], "closure_limits": 2 * [{"swing_rad": 0.5}]}
    path = _saved(tmp_path, FIVE_BAR, more)
    assert [loop.name for loop in pm.load(path).closures] == ["left_tip-right_tip", "left_tip-right_tip-2"]
    swings = answer("ik", "--robot", str(path), "0.0", "0.4")["swing_rad"]
    assert sorted(swings) == ["left_tip-right_tip", "left_tip-right_tip-2"]
    assert list(swings.values()) == pytest.approx([0.0, 0.0], abs=1e-7)


@pytest.mark.parametrize("pair", [["tip0", "ball0"], ["ball0", "tip0"]])
def test_a_distance_is_held_once(six_rods: Path, tmp_path: Path, pair: list[str]) -> None:
    """Two rods between the same frames would be one number with two names, or of two lengths."""
    path = _saved(tmp_path, six_rods, {"closed_loop": [pair], "type": ["distance"], "closure_lengths": [0.3]})
    with pytest.raises(
        DescriptionError, match=r"closed_loop\[6\].*closed_loop\[0\] holds the distance of these frames"
    ):
        pm.load(path)
