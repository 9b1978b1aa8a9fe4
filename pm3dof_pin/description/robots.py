"""Find the files of a robot, in any supported format, from a name or a path."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Literal

from pm3dof_pin.description.expand import expand_xacro, is_xacro_trusted
from pm3dof_pin.description.own_files import package_of
from pm3dof_pin.description.xml_file import Element, parse_xml, read_root_tag, read_xml
from pm3dof_pin.exceptions import DescriptionError, InvalidValueError, UnknownRobotError
from pm3dof_pin.files import read_text

_logger = logging.getLogger(__name__)

DESCRIPTION_SUFFIX = "_description"
CLOSURES_SUFFIX = ".closures.yaml"
_CLOSURES_FALLBACK = "robot.yaml"
_CLOSURES_FALLBACKS = (_CLOSURES_FALLBACK, "loop_closures.yaml")

Format = Literal["urdf", "mjcf", "sdf"]

_FORMAT_OF_ROOT: dict[str, Format] = {"robot": "urdf", "mujoco": "mjcf", "sdf": "sdf"}
_NOT_READ = {"COLLADA": "Collada", "Robot": "OpenRAVE XML", "KinBody": "OpenRAVE XML", "svg": "SVG"}


@dataclass(frozen=True)
class RobotFiles:
    """The files of one robot."""

    name: str  #: name of the robot, or the stem of its file
    path: Path  #: file with the tree of bodies and joints; relative file names in it start there
    closures: Path | None = None  #: file with loop closures, actuated joints, tool frame and springs, if any
    srdf: Path | None = None  #: file with named configurations and collision pairs, if any
    format: Format = "urdf"  #: format of the tree; MJCF includes loop closures and more
    package_paths: tuple[Path, ...] = ()  #: folders to search for the ROS packages of meshes, in order
    #: folders that files may be read from: the description's own and those given
    own_folders: tuple[Path, ...] = ()
    expansion: str | None = None  #: what the file expands to if it is a xacro

    @property
    def urdf(self) -> Path:
        """The URDF file; DescriptionError if the tree is in another format."""
        if self.format != "urdf":
            raise DescriptionError(self.path, "file", f"expected URDF for this, not {self.format.upper()}")
        return self.path

    @property
    def source(self) -> Path:
        """The file with the names of closures, drives and springs."""
        return self.closures or self.path

    @property
    def errors(self) -> Path:
        """The error file, which may not exist."""
        beside = self.closures if self.expansion is not None and self.closures else self.path
        return beside.with_name(f"{self.name}.errors.yaml")

    @property
    def tree_name(self) -> str:
        """Name of a file with the tree, that of a URDF for a xacro."""
        return self.path.name if self.expansion is None else f"{self.name}.urdf"

    def tree_text(self) -> str:
        """Read the text with the tree; DescriptionError if the file is unreadable."""
        return read_text(self.path) if self.expansion is None else self.expansion

    def read_tree(self) -> Element:
        """Read the root element of the tree, as :func:`~pm3dof_pin.description.xml_file.read_xml`."""
        return read_xml(self.path) if self.expansion is None else parse_xml(self.expansion.encode(), self.path)


def robots_directory() -> Path:
    """Return the folder of robot descriptions: inside the installed package, or next to it in a checkout."""
    package = Path(__file__).resolve().parents[1]
    installed = package / "robots"
    return installed if installed.is_dir() else package.parent / "robots"


def robot_names() -> list[str]:
    """Return the sorted names of the robots that come with the package.

    Example:
        >>> import pm3dof_pin as pm
        >>> pm.robot_names()
        ['ankle_rus', 'ankle_spu', 'hexapod', 'linear_delta', 'pm3dof', 'three_rps']
    """
    return sorted(
        folder.name.removesuffix(DESCRIPTION_SUFFIX) for folder in robots_directory().glob(f"*{DESCRIPTION_SUFFIX}")
    )


def find_robot(
    name_or_path: str | Path,
    package_paths: Iterable[str | Path] = (),
    xacro_args: Mapping[str, str] | None = None,
) -> RobotFiles:
    """Find the files of a robot.

    Args:
        name_or_path: one of:

            - a name of :func:`robot_names`, or of a robot of example-robot-data or a module of robot_descriptions
              (`cassie_mj_description`) where these are installed;
            - a URDF `x.urdf`. Its closures file `x.closures.yaml` or `robot.yaml` may be next to it or in `../urdf`,
              its SRDF `x.srdf` next to it or in `../srdf`; without a closures file it is a serial robot;
              they may also be called `x.urdf.closures.yaml` and `x.urdf.srdf`;
            - a xacro file that expands to one of these;
            - an MJCF file, or an SDF file with one model; `x.xml.closures.yaml`, and `x.closures.yaml` if there is no
              `x.urdf` that it belongs to, may add to it;
            - a closures file, `x.closures.yaml` or `robot.yaml`, with its URDF next to it;
            - a folder with one of these: `robot.yaml` with `robot.urdf`, or the folder of a ROS package with `urdf/`.
        package_paths: folders of ROS packages, searched before ROS_PACKAGE_PATH and the folders above the file.
        xacro_args: values of arguments (`xacro:arg`) of a xacro file, by name; the others have their defaults.

    Raises:
        UnknownRobotError: neither a known name nor an existing path.
        DescriptionError: the path does not describe a robot, or describes several.
    """
    tree, closures = _tree_and_closures(_existing_path(name_or_path))
    environment = os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)
    packages = [Path(folder) for folder in (*package_paths, *environment) if folder]
    name, expansion = tree.stem, None
    if tree.suffix == ".xacro":
        name = Path(name).stem if Path(name).suffix in (".urdf", ".xml", ".sdf") else name
        arguments = tuple(sorted((xacro_args or {}).items()))
        expansion = _expanded(tree.resolve(), tuple(packages), arguments, is_xacro_trusted())
    elif xacro_args:
        raise DescriptionError(tree, "file", f"is not a xacro file, so it has no argument {next(iter(xacro_args))}")
    form = _format_of(tree, expansion)
    own = tree if expansion is None else None
    if closures is None:
        fallbacks = _CLOSURES_FALLBACKS if form == "urdf" else ()
        closures = _beside(tree, "urdf", tree.name + CLOSURES_SUFFIX) or _beside(
            tree, "urdf", name + CLOSURES_SUFFIX, *fallbacks, own=own
        )
    srdf = _beside(tree, "srdf", f"{tree.name}.srdf") or _beside(
        tree, "srdf", f"{name}.srdf", own=own if form != "urdf" else None
    )
    return RobotFiles(
        name=name,
        path=tree,
        closures=closures,
        srdf=srdf,
        format=form,
        package_paths=(*packages, *tree.resolve().parents),
        own_folders=(package_of(tree), *packages),
        expansion=expansion,
    )


def _existing_path(name_or_path: str | Path) -> Path:
    name = str(name_or_path)
    if name in robot_names():
        return robots_directory() / f"{name}{DESCRIPTION_SUFFIX}" / "urdf" / f"{name}.urdf"
    if name and Path(name).exists():
        return Path(name)
    if (example := _example_robot(name)) is not None:
        return example
    if name.isidentifier() and name.endswith(DESCRIPTION_SUFFIX) and find_spec("robot_descriptions") is not None:
        return _described_robot(name)
    raise UnknownRobotError(name, robot_names())


def _described_robot(name: str) -> Path:
    """The file of a robot of robot_descriptions, which fetches it when it is first imported."""
    try:
        return path_of_module(import_module(f"robot_descriptions.{name}"))
    except ModuleNotFoundError:
        raise UnknownRobotError(name, robot_names()) from None
    except (ImportError, OSError, RuntimeError) as error:
        raise DescriptionError(name, "robot_descriptions", f"could not fetch it: {error}") from error


def path_of_module(module: ModuleType) -> Path:
    """Return the file that a module of robot_descriptions names; InvalidValueError if it names none."""
    for attribute in ("URDF_PATH", "MJCF_PATH", "XACRO_PATH"):
        if path := getattr(module, attribute, None):
            return Path(path)
    raise InvalidValueError("robot", problem=f"module {module.__name__} has no URDF_PATH or MJCF_PATH")


def example_robot_names() -> list[str]:
    """Return the sorted names of the robots of example-robot-data, none if that is not installed."""
    try:
        from example_robot_data.robots_loader import ROBOTS
    except ImportError:
        return []
    return sorted(ROBOTS)


def _example_robot(name: str) -> Path | None:
    """The URDF of a robot of example-robot-data, if that is installed."""
    try:
        from example_robot_data.robots_loader import ROBOTS, getModelPath
    except ImportError:
        return None
    if name not in ROBOTS:
        return None
    robot = ROBOTS[name]
    below = Path(robot.path, robot.urdf_subpath, robot.urdf_filename or robot.sdf_filename)
    return (Path(getModelPath(str(below))) / below).resolve()


def _tree_and_closures(path: Path) -> tuple[Path, Path | None]:
    """Find the tree that a path refers to, and the closures file if the path names one."""
    if path.is_dir():
        if (path / _CLOSURES_FALLBACK).is_file():
            return _tree_and_closures(path / _CLOSURES_FALLBACK)
        for pattern in ("*.urdf", "urdf/*.urdf", "*.urdf.xacro", "*/*.urdf.xacro", "*.xml", "mjcf/*.xml", "*.sdf"):
            if trees := sorted(tree for tree in path.glob(pattern) if tree.suffix != ".xml" or _is_mjcf(tree)):
                return _only(trees, path), None
        raise DescriptionError(path, "folder", "expected a URDF, a xacro, an MJCF or an SDF file in it, or in urdf/")
    if path.suffix not in (".yaml", ".yml"):
        return path, None
    if path.name.endswith(CLOSURES_SUFFIX):
        name = path.name.removesuffix(CLOSURES_SUFFIX)
        if (tree := path.with_name(name)).suffix and tree.is_file():
            return tree, path
        trees = [path.with_name(f"{name}.urdf"), path.with_name(f"{name}.xml"), path.with_name(f"{name}.sdf")]
    else:
        trees = [path.with_suffix(".urdf"), *sorted(path.parent.glob("*.urdf"))]
    trees = [tree for tree in trees if tree.is_file()]
    if not trees:
        raise DescriptionError(path, "URDF", "expected the URDF of this file next to it")
    return trees[0] if trees[0].stem == path.name.split(".")[0] else _only(trees, path.parent), path


def _only(trees: Sequence[Path], folder: Path) -> Path:
    if len(trees) > 1:
        names = ", ".join(str(tree.relative_to(folder)) for tree in trees)
        raise DescriptionError(folder, "folder", f"expected one robot, or the path of one of {names}")
    return trees[0]


def _beside(tree: Path, folder: str, *names: str, own: Path | None = None) -> Path | None:
    """Find a file next to the tree, or in a folder next to the tree's folder.

    With `own`, the tree, not a file that belongs to a URDF of its name, which stands next to the file or in `urdf` of
    the same package: the MJCF, SDF or URDF for Drake of that robot has loops and coordinates of its own.
    """
    for path in (place / name for name in names for place in (tree.parent, tree.parent.parent / folder)):
        if not os.path.lexists(path):  # an unreadable one is an error
            continue
        urdfs = [path.with_name(f"{path.name.partition('.')[0]}.urdf")]
        if path.parent != tree.parent:
            urdfs.append(path.parent.parent / "urdf" / urdfs[0].name)
        if own is None or not any(urdf.is_file() and not urdf.samefile(own) for urdf in urdfs):
            return path
        _logger.info("%s: %s belongs to %s, and is not read", tree, path, urdfs[0].name)
    return None


def _format_of(tree: Path, expansion: str | None) -> Format:
    tag = read_root_tag(tree) if expansion is None else parse_xml(expansion.encode(), tree).tag
    if tag not in _FORMAT_OF_ROOT:
        form = _NOT_READ.get(tag, f"an XML file of <{tag}>")
        raise DescriptionError(
            tree, "file", f"this is {form}, which is not supported: expected URDF, xacro, MJCF or SDF"
        )
    return _FORMAT_OF_ROOT[tag]


def _is_mjcf(tree: Path) -> bool:
    try:
        return read_root_tag(tree) == "mujoco"
    except DescriptionError:
        return False


@cache
def _expanded(xacro: Path, packages: tuple[Path, ...], arguments: tuple[tuple[str, str], ...], trusted: bool) -> str:
    """Expand a xacro file, once per process."""
    return expand_xacro(xacro, dict(arguments), package_paths=packages)
