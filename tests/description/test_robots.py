"""Robots found by name or by the path of their URDF."""

from __future__ import annotations

from pathlib import Path

import pytest

from pm3dof_pin.description.robots import example_robot_names, find_robot, robot_names, robots_directory
from pm3dof_pin.exceptions import DescriptionError, UnknownRobotError
from pm3dof_pin.kinematics.robot import Robot


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
    """A URDF without a closures file."""
    path = tmp_path / "urdf" / "arm.urdf"
    path.parent.mkdir()
    path.write_text("<robot name='arm'/>")
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


def test_a_urdf_without_closures_file_is_a_robot(urdf: Path) -> None:
    robot = find_robot(urdf)
    assert (robot.path, robot.closures, robot.source) == (urdf, None, urdf)


@pytest.mark.parametrize("place", ["urdf", "urdf/arm.urdf", "urdf/arm.closures.yaml", "."])
def test_the_folder_the_urdf_and_the_closures_file_are_one_robot(urdf: Path, place: str) -> None:
    closures = urdf.with_name("arm.closures.yaml")
    closures.touch()
    robot = find_robot(urdf.parent.parent / place)
    assert (robot.name, robot.urdf, robot.closures) == ("arm", urdf, closures)


def test_the_folders_of_example_parallel_robots(tmp_path: Path) -> None:
    for name in ("robot.urdf", "robot_old.urdf"):
        (tmp_path / name).write_text("<robot name='delta'/>")
    (tmp_path / "robot.yaml").touch()
    for path in (tmp_path, tmp_path / "robot.yaml"):
        robot = find_robot(path)
        assert (robot.urdf, robot.closures) == (tmp_path / "robot.urdf", tmp_path / "robot.yaml")


def test_a_folder_of_several_robots_or_none_is_refused(urdf: Path, tmp_path: Path) -> None:
    urdf.with_name("leg.urdf").write_text("<robot name='leg'/>")
    with pytest.raises(DescriptionError, match=r"expected one robot, or the path of one of arm\.urdf, leg\.urdf"):
        find_robot(urdf.parent)
    (tmp_path / "empty").mkdir()
    with pytest.raises(DescriptionError, match="expected a URDF, a xacro, an MJCF or an SDF file"):
        find_robot(tmp_path / "empty")


def test_a_closures_file_alone_is_refused(tmp_path: Path) -> None:
    (tmp_path / "arm.closures.yaml").touch()
    with pytest.raises(DescriptionError, match=r"arm\.closures\.yaml: URDF: expected the URDF .* next to it"):
        find_robot(tmp_path / "arm.closures.yaml")


def test_xacro_is_expanded(tmp_path: Path) -> None:
    path = tmp_path / "xacro" / "arm.urdf.xacro"
    path.parent.mkdir()
    path.write_text(
        '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:property name="n" value="forearm"/>'
        '<link name="${n}"/></robot>'
    )
    closures = tmp_path / "urdf" / "arm.closures.yaml"
    closures.parent.mkdir()
    closures.touch()
    robot = find_robot(path)
    assert robot.name == "arm"
    assert '<link name="forearm"' in robot.tree_text()
    assert robot.closures == closures
    assert path.parent in robot.package_paths
    assert (robot.path, robot.tree_name) == (path, "arm.urdf")
    assert robot.errors == closures.with_name("arm.errors.yaml")


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("arm.dae", "<COLLADA xmlns='http://www.collada.org/2005/11/COLLADASchema'/>", "this is Collada"),
        ("arm.xml", "<scene/>", "this is an XML file of <scene>, which is not supported"),
        ("arm.stl", "solid arm", "line 1, column 0: expected XML"),
    ],
)
def test_what_is_no_robot_is_refused_by_what_it_is(tmp_path: Path, name: str, text: str, said: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(DescriptionError, match=said):
        find_robot(tmp_path / name)


def test_an_mjcf_file_is_told_by_its_root(tmp_path: Path) -> None:
    path = tmp_path / "arm.xml"
    path.write_text("<mujoco/>")
    robot = find_robot(path)
    assert (robot.path, robot.format, robot.closures) == (path, "mjcf", None)
    with pytest.raises(DescriptionError, match="expected URDF for this, not MJCF"):
        _ = robot.urdf


def test_packages_are_looked_for_where_ros_has_them(urdf: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_PACKAGE_PATH", "/opt/here:/opt/there")
    folders = find_robot(urdf, ["/first"]).package_paths
    assert folders[:3] == (Path("/first"), Path("/opt/here"), Path("/opt/there"))
    assert folders[3:5] == (urdf.parent, urdf.parent.parent)


def test_robots_of_example_robot_data_have_names() -> None:
    pytest.importorskip("example_robot_data")
    robot = find_robot("ur5")
    assert robot.urdf.parts[-3:] == ("ur_description", "urdf", "ur5_robot.urdf")


def test_robots_of_example_robot_data_load_or_name_what_is_wrong_in_their_file() -> None:
    """One hand's fingers follow joints that its file does not have."""
    pytest.importorskip("example_robot_data")
    problems: list[DescriptionError] = []
    for name in example_robot_names():
        try:
            Robot.load(name)
        except DescriptionError as error:
            problems.append(error)
    assert [str(problem) for problem in problems if problem.line is None] == []


@pytest.mark.parametrize("name", ["pm4dof", "nowhere/arm.urdf", ""])
def test_an_unknown_robot_is_refused_with_the_known_ones(name: str) -> None:
    with pytest.raises(UnknownRobotError, match="pm3dof") as caught:
        find_robot(name)
    assert caught.value.name == name
    assert "pm3dof" in caught.value.known
