"""Exports include meshes of the robot's own folder and of given packages, and no other file."""

from __future__ import annotations

from pathlib import Path

import pytest

from pm3dof_pin.description.own_files import package_of
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.export.formats import export_robot

ROBOT = """<robot name="arm"><link name="base">
<visual><geometry><mesh filename="{}"/></geometry></visual></link><link name="forearm"/>
<joint name="elbow" type="continuous"><parent link="base"/><child link="forearm"/></joint></robot>"""
TRIANGLE = """solid t
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 1 0
endloop
endfacet
endsolid t
"""


def _write(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """An external package next to private files, and next to another package."""
    _write(tmp_path / "secret.stl", TRIANGLE)
    _write(tmp_path / "private" / "keys.stl", TRIANGLE)
    _write(tmp_path / "parts" / "package.xml", "<package/>")
    _write(tmp_path / "parts" / "part.stl", TRIANGLE)
    own = tmp_path / "arm_description"
    _write(own / "meshes" / "arm.stl", TRIANGLE)
    _write(own / "notes.txt", "no mesh")
    (own / "meshes" / "linked.stl").symlink_to(tmp_path / "secret.stl")
    return own


@pytest.mark.parametrize(
    "name",
    [
        "/etc/passwd",
        "file:///etc/passwd",
        "../../secret.stl",
        "{above}/secret.stl",
        "file://{above}/secret.stl",
        "package://arm_description/../secret.stl",
        "package://../secret.stl",
        "package://private/keys.stl",
        "package:///etc/passwd",
        "package://parts/../secret.stl",
        "../meshes/linked.stl",
        "../notes.txt",
    ],
)
def test_files_of_elsewhere_are_refused_by_name(folder: Path, tmp_path: Path, name: str) -> None:
    name = name.format(above=tmp_path)
    urdf = _write(folder / "urdf" / "arm.urdf", ROBOT.format(name))
    with pytest.raises(DescriptionError, match=f"mesh '{name}': .*expected"):
        export_robot(urdf, "urdf", tmp_path / "out")
    assert not list(tmp_path.glob("out/**/*.stl"))
    assert not list(tmp_path.glob("out/**/passwd*"))


@pytest.mark.parametrize(
    "name", ["../meshes/arm.stl", "package://arm_description/meshes/arm.stl", "package://parts/part.stl"]
)
def test_own_meshes_and_those_of_packages_are_taken(folder: Path, tmp_path: Path, name: str) -> None:
    urdf = _write(folder / "urdf" / "arm.urdf", ROBOT.format(name))
    export_robot(urdf, "urdf", tmp_path / "out")
    assert [path.read_text(encoding="utf-8") for path in tmp_path.glob("out/**/*.stl")] == [TRIANGLE]


def test_a_folder_that_is_named_is_one_of_ours(folder: Path, tmp_path: Path) -> None:
    urdf = _write(folder / "urdf" / "arm.urdf", ROBOT.format("keys.stl"))
    export_robot(urdf, "urdf", tmp_path / "out", package_paths=[tmp_path / "private"])
    assert (tmp_path / "out" / "meshes" / "keys.stl").is_file()


def test_a_package_is_not_looked_for_without_end(tmp_path: Path) -> None:
    """Otherwise a package.xml far above, in a user's home, would own everything below it."""
    (tmp_path / "package.xml").touch()
    near, far = tmp_path / "a" / "b" / "c" / "urdf", tmp_path / "a" / "b" / "c" / "d" / "e" / "urdf"
    assert package_of(near / "arm.urdf") == tmp_path
    assert package_of(far / "arm.urdf") == far.parent


def test_files_of_the_same_project_belong_to_a_robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A git repository, or else a folder with a licence or a readme; never the user's home folder or one above it."""
    robot = tmp_path / "project" / "robots" / "cell" / "cell.xml"
    assert package_of(robot) == robot.parent
    robot.parent.mkdir(parents=True)
    (robot.parent.parent / "README.md").touch()
    assert package_of(robot) == robot.parent.parent
    (tmp_path / "project" / ".git").mkdir()
    assert package_of(robot) == tmp_path / "project"
    monkeypatch.setenv("HOME", str(tmp_path / "project"))
    assert package_of(robot) == robot.parent.parent
