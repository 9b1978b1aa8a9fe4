"""The ROS 2 package, as far as its files can be checked without ROS."""

from __future__ import annotations

import runpy
import shutil
import subprocess
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pinocchio as pin
import pytest
import yaml

from pm3dof_pin.description.expand import expand_xacro
from pm3dof_pin.description.robots import robot_names, robots_directory
from pm3dof_pin.export.formats import export_robot
from pm3dof_pin.export.ros import ros_package_name
from pm3dof_pin.kinematics.robot import Robot


class Recorded:
    """Stand-in for a class of ROS that keeps its arguments."""

    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        self.arguments = arguments
        self.keywords = keywords


@pytest.fixture
def ros(monkeypatch: pytest.MonkeyPatch) -> Callable[[Path], None]:
    """Stand-ins for the modules that a launch file imports; gets the folder that is installed as the package."""
    share = {}
    contents = {
        "ament_index_python.packages": {"get_package_share_directory": lambda name: str(share[name])},
        "launch": {"LaunchDescription": Recorded},
        "launch_ros.actions": {"Node": Recorded},
        "launch_ros.parameter_descriptions": {"ParameterValue": Recorded},
    }
    for name in ("ament_index_python", "launch_ros", *contents):
        module = types.ModuleType(name)
        vars(module).update(contents.get(name, {}))
        monkeypatch.setitem(sys.modules, name, module)
    return lambda folder: share.update({folder.name: folder})


def _package(robot: str) -> Path:
    return robots_directory() / f"{robot}_description"


def _manifest(folder: Path) -> ElementTree.Element:
    return ElementTree.parse(folder / "package.xml").getroot()


def test_the_manifest_is_one(robot: str) -> None:
    parse = pytest.importorskip("catkin_pkg.package").parse_package
    warnings: list[str] = []
    package = parse(str(_package(robot) / "package.xml"), warnings=warnings)
    package.validate()
    assert not warnings
    assert package.name == _package(robot).name == f"{robot}_description"
    assert package.licenses == ["BSD-2-Clause"]
    assert [person.email.endswith(".invalid") for person in package.maintainers] == [True]  # not a real address
    assert package.get_build_type() == "ament_cmake"


def test_the_launch_file_starts_nodes_of_declared_packages_with_files_that_exist(
    robot: str, ros: Callable[[Path], None]
) -> None:
    folder = _package(robot)
    ros(folder)
    launch = runpy.run_path(str(folder / "launch" / "display.launch.py"))["generate_launch_description"]
    nodes = launch().arguments[0]
    assert [node.keywords["executable"] for node in nodes] == [
        "robot_state_publisher",
        "joint_state_publisher_gui",
        "rviz2",
    ]
    declared = {element.text for element in _manifest(folder).iter("exec_depend")}
    assert {node.keywords["package"] for node in nodes} <= declared
    (description,) = nodes[0].keywords["parameters"]
    assert description["robot_description"].keywords == {"value_type": str}
    model = pin.buildModelFromXML(description["robot_description"].arguments[0])
    assert model.nq == Robot.load(robot).model.nq
    option, config = nodes[2].keywords["arguments"]
    assert option == "-d"
    assert Path(config).is_file()


def test_the_rviz_file_shows_the_robot_in_its_base(robot: str) -> None:
    config = yaml.safe_load((_package(robot) / "rviz" / "display.rviz").read_text())["Visualization Manager"]
    root = ElementTree.parse(_package(robot) / "urdf" / f"{robot}.urdf").getroot()
    assert root.find(f"link[@name='{config['Global Options']['Fixed Frame']}']") is not None
    (model,) = [display for display in config["Displays"] if display["Class"].endswith("/RobotModel")]
    assert model["Description Topic"]["Value"] == "/robot_description"


def test_a_package_needs_no_other(tmp_path: Path, robot: str) -> None:
    folder = shutil.copytree(_package(robot), tmp_path / f"{robot}_description")
    committed = (_package(robot) / "urdf" / f"{robot}.urdf").read_text(encoding="utf-8")
    assert expand_xacro(folder / "xacro" / f"{robot}.urdf.xacro") == committed


@pytest.mark.skipif(shutil.which("cmake") is None, reason="no cmake")
def test_a_package_installs_by_itself(tmp_path: Path) -> None:
    """Copied into an empty workspace and installed into a separate folder, as by colcon, with all its contents.

    Uses an ament_cmake that has only its last command. The packages of all robots are installed alike.
    """
    name = "pm3dof_description"
    recipes = [(_package(robot) / "CMakeLists.txt").read_text().replace(robot, "pm3dof") for robot in robot_names()]
    assert set(recipes) == {(_package("pm3dof") / "CMakeLists.txt").read_text()}
    ament = tmp_path / "ament"
    ament.mkdir()
    (ament / "ament_cmakeConfig.cmake").write_text("macro(ament_package)\nendmacro()\n")
    source, build, prefix = tmp_path / "src" / name, tmp_path / "build", tmp_path / "install" / name
    shutil.copytree(_package("pm3dof"), source)
    for command in (
        ["cmake", "-S", str(source), "-B", str(build), f"-Dament_cmake_DIR={ament}"],
        ["cmake", "--install", str(build), "--prefix", str(prefix)],
    ):
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    share = prefix / "share" / name
    shutil.rmtree(source)
    for path in ("urdf/pm3dof.urdf", "srdf/pm3dof.srdf", "launch/display.launch.py", "rviz/display.rviz"):
        assert (share / path).is_file()
    committed = (_package("pm3dof") / "urdf" / "pm3dof.urdf").read_text(encoding="utf-8")
    assert expand_xacro(share / "xacro" / "pm3dof.urdf.xacro") == committed


def test_a_robot_of_ones_own(four_bar: Path, tmp_path: Path, ros: Callable[[Path], None]) -> None:
    written = export_robot(four_bar, "ros", tmp_path / "src")
    folder = tmp_path / "src" / "four_bar_description"
    assert all(folder in path.parents for path in written)
    manifest = _manifest(folder)
    assert (manifest.findtext("name"), manifest.findtext("license")) == (folder.name, "TODO: License declaration")
    assert manifest.find("maintainer").get("email") == "user@todo.todo"  # of `ros2 pkg create`
    ros(folder)
    launch = runpy.run_path(str(folder / "launch" / "display.launch.py"))["generate_launch_description"]
    urdf = launch().arguments[0][0].keywords["parameters"][0]["robot_description"].arguments[0]
    for mesh in ElementTree.fromstring(urdf).iter("mesh"):
        package, _, path = mesh.get("filename", "").removeprefix("package://").partition("/")
        assert package == folder.name
        assert (folder / path).is_file()
    assert Robot.load(folder / "urdf" / "four_bar.urdf").model.nq == Robot.load(four_bar).model.nq


@pytest.mark.parametrize(
    ("robot", "package"),
    [("pm3dof", "pm3dof_description"), ("My Robot-2", "my_robot_2_description"), ("3RPS", "robot_3rps_description")],
)
def test_names_of_packages(robot: str, package: str) -> None:
    assert ros_package_name(robot) == package
