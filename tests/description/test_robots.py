"""Robots found by name or by the path of their URDF."""

from __future__ import annotations

from pathlib import Path

import pytest

from pm3dof_pin.description.robots import find_robot, robot_names, robots_directory
from pm3dof_pin.exceptions import DescriptionError, UnknownRobotError


def test_the_chapters_machine_comes_with_the_package() -> None:
    assert "pm3dof" in robot_names()
    robot = find_robot("pm3dof")
    folder = robots_directory() / "pm3dof_description"
    assert robot.name == "pm3dof"
    assert robot.urdf == folder / "urdf" / "pm3dof.urdf"
    assert robot.closures == folder / "urdf" / "pm3dof.closures.yaml"
    assert robot.srdf == folder / "srdf" / "pm3dof.srdf"
    assert all(path.is_file() for path in (robot.urdf, robot.closures, robot.srdf))


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    """A URDF with nothing beside it."""
    path = tmp_path / "urdf" / "arm.urdf"
    path.parent.mkdir()
    path.touch()
    return path


@pytest.mark.parametrize("closures", ["arm.closures.yaml", "robot.yaml"])
def test_a_path_is_found_with_the_closures_beside_it(urdf: Path, closures: str) -> None:
    urdf.with_name(closures).touch()
    robot = find_robot(str(urdf))
    assert (robot.name, robot.urdf, robot.closures, robot.srdf) == ("arm", urdf, urdf.with_name(closures), None)


def test_the_closures_of_the_robots_own_name_come_first(urdf: Path) -> None:
    for name in ("robot.yaml", "arm.closures.yaml"):
        urdf.with_name(name).touch()
    assert find_robot(urdf).closures.name == "arm.closures.yaml"


@pytest.mark.parametrize("place", ["urdf/arm.srdf", "srdf/arm.srdf"])
def test_the_srdf_stands_beside_the_urdf_or_in_its_own_folder(urdf: Path, place: str) -> None:
    urdf.with_name("robot.yaml").touch()
    srdf = urdf.parent.parent / place
    srdf.parent.mkdir(exist_ok=True)
    srdf.touch()
    assert find_robot(urdf).srdf == srdf


def test_a_urdf_without_closures_file_is_refused(urdf: Path) -> None:
    with pytest.raises(DescriptionError, match=r"expected arm\.closures\.yaml or robot\.yaml beside the URDF"):
        find_robot(urdf)


@pytest.mark.parametrize("name", ["pm4dof", "nowhere/arm.urdf", ""])
def test_an_unknown_robot_is_refused_with_the_known_ones(name: str) -> None:
    with pytest.raises(UnknownRobotError, match="pm3dof") as caught:
        find_robot(name)
    assert caught.value.name == name
    assert "pm3dof" in caught.value.known
