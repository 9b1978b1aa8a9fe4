"""The page for whoever carries on names files that exist, and its diffs fit them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "carrying_on.md").read_text(encoding="utf-8")
DIFFS = re.findall(r"^```diff\n--- (\S+)\n(.*?)^```$", PAGE, flags=re.DOTALL | re.MULTILINE)
FILES = re.findall(r"`((?:[a-z_0-9]+/)+[a-z_0-9]*(?:\.(?:py|js|md))?)`", PAGE)


@pytest.mark.parametrize("name", sorted(set(FILES)))
def test_files_exist(name: str) -> None:
    assert (ROOT / "pm3dof_pin" / name).exists() or (ROOT / name).exists()


@pytest.mark.parametrize(("name", "diff"), DIFFS, ids=[f"{k} {name}" for k, (name, _) in enumerate(DIFFS)])
def test_diffs_fit(name: str, diff: str) -> None:
    """Lines that stay or go are in the file, in this order; lines that come are not."""
    lines = (ROOT / name).read_text(encoding="utf-8").splitlines()
    place = 0
    for line in diff.splitlines():
        if line.startswith("+"):
            assert line[1:] not in lines
        else:
            place = lines.index(line[1:], place) + 1


def test_every_room_is_in_the_picture() -> None:
    picture = PAGE.split("```text\n")[1].split("```")[0]
    rooms = {path.stem for path in (ROOT / "pm3dof_pin").iterdir() if path.is_dir() or path.suffix == ".py"}
    assert {room for room in rooms if not room.startswith("_")} <= set(re.findall(r"\w+", picture))
