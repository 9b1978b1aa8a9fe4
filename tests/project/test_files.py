"""Files: only regular ones are read, writing is atomic, and leftovers of killed processes are removed."""

from __future__ import annotations

import contextlib
import csv
import io
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.files import (
    csv_text,
    read_bytes,
    replace_directory,
    without_apostrophe,
    write_atomically,
    write_text_atomically,
)
from pm3dof_pin.kinematics.robot import Robot

KILLED = """
import os, signal
from pm3dof_pin.files import {writer}
with {writer}({arguments}) as temporary:
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGKILL")
def test_litter_of_a_killed_process_goes_with_the_next_write(tmp_path: Path) -> None:
    file, folder = tmp_path / "map.nc", tmp_path / "results"
    for writer, arguments in (
        ("write_atomically", f"{str(file)!r}"),
        ("replace_directory", f"{str(folder)!r}, 'mark'"),
    ):
        code = KILLED.format(writer=writer, arguments=arguments)
        assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -signal.SIGKILL
    assert len(list(tmp_path.iterdir())) == 2  # hidden ones
    with write_atomically(file) as temporary:
        assert [path for path in tmp_path.iterdir() if path.suffix == ".nc"] == [temporary]
        write_text_atomically(tmp_path / "map.txt", "another file beside it")
        assert temporary.exists()
        temporary.write_text("whole", encoding="utf-8")
    with replace_directory(folder, "mark") as fresh:
        (fresh / "mark").touch()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["map.nc", "map.txt", "results"]


def test_temporaries_of_running_processes_and_other_computers_stay(tmp_path: Path) -> None:
    with write_atomically(tmp_path / "map.nc") as first, write_atomically(tmp_path / "map.nc") as second:
        assert first.exists()
        second.write_text("second", encoding="utf-8")
        first.write_text("first", encoding="utf-8")
        foreign = tmp_path / ".map-elsewhere-1-x.nc"
        foreign.touch()
    write_text_atomically(tmp_path / "map.nc", "third")
    assert foreign.exists()
    assert (tmp_path / "map.nc").read_text(encoding="utf-8") == "third"


@pytest.mark.skipif(sys.platform == "win32", reason="there are no pipes with names, and links need rights")
@pytest.mark.parametrize("kind", ["pipe", "folder", "device", "loop", "hole"])
def test_what_is_no_ordinary_file_is_refused_at_once(kind: str, tmp_path: Path) -> None:
    file = tmp_path / "arm.closures.yaml"
    match kind:
        case "pipe":
            os.mkfifo(file)
        case "folder":
            file.mkdir()
        case "device":
            file.symlink_to("/dev/zero")
        case "loop":
            file.symlink_to(file)
        case "hole":
            with file.open("wb") as hole:
                hole.truncate(1 << 40)
    with pytest.raises(DescriptionError, match=r"arm\.closures\.yaml: file: expected"):
        read_bytes(file)
    (tmp_path / "arm.urdf").write_text('<robot name="arm"><link name="base"/></robot>', encoding="utf-8")
    with pytest.raises(DescriptionError, match=r"arm\.closures\.yaml: file: expected"):
        Robot.load(tmp_path / "arm.urdf")


@pytest.mark.parametrize("name", ["a\0b.yaml", "x" * 5000])
def test_names_that_no_file_can_have_are_refused(name: str) -> None:
    with pytest.raises(DescriptionError, match="expected a readable file"):
        read_bytes(name)


def test_csv_has_no_formulas_and_is_read_as_it_was_written() -> None:
    """Of Excel and LibreOffice: a cell that begins with =, +, - or @ is computed, unless it is a number."""
    cells = [
        "=HYPERLINK(1)",
        "+cmd",
        "-a",
        "@sum",
        "\ttab",
        "-0.5",
        "+1e-3",
        "-inf",
        "a,b",
        'say "x"',
        "two\nlines",
        "it's",
    ]
    (read,) = csv.reader(io.StringIO(csv_text([[*cells, float("nan"), 0.1, -2]]), newline=""))
    assert [without_apostrophe(cell) for cell in read] == [*cells, "", "0.1", "-2"]
    for cell in read:
        with contextlib.suppress(ValueError):
            float(cell)
            continue
        assert cell[:1] not in {"=", "+", "-", "@", "\t"}
