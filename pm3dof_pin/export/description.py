"""The description of a robot as text, generated from its xacro and its parameter file, and its exports."""

from __future__ import annotations

import atexit
import logging
import math
import re
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path

import yaml

from pm3dof_pin.description.expand import expand_xacro
from pm3dof_pin.description.parameters import find_parameters, read_parameters, read_quantities
from pm3dof_pin.description.robots import DESCRIPTION_SUFFIX, robot_names, robots_directory
from pm3dof_pin.exceptions import DescriptionError, UnknownRobotError
from pm3dof_pin.export.closures_file import closures_text
from pm3dof_pin.export.formats import exported_files
from pm3dof_pin.export.named_configurations import srdf_text
from pm3dof_pin.export.robot_document import read_robot
from pm3dof_pin.export.ros import OUR_MANIFEST, ros_files
from pm3dof_pin.files import write_text_atomically

_logger = logging.getLogger(__name__)

_FOLDERS = ("drake", "gepetto", "mjcf", "sdf")
_SHARED = re.compile(r"<xacro:include filename=\"(shared/(\w+\.xacro))\"/>")
_COPIED = """\
<?xml version="1.0"?>
<!-- A copy of {folder}/xacro/{name}, so that this folder needs no other one. Edit that file, not this one. -->
"""
_WORDS = re.compile(r"([\s\",\[\]{}]+)")


def description_files(robot: str = "pm3dof", *, config: Path | str | None = None) -> dict[str, str]:
    """Return the text of every generated file of a packaged robot's description, by its path in the folder.

    With another parameter file of the same layout, the xacro files that it shares with other robots are left out. So
    is, and logged, a format that cannot say what this robot is, such as a body that moves and has no mass.

    Raises:
        UnknownRobotError: no such robot.
        DescriptionError: a quantity is missing from the parameter file or wrong, or the geometry it describes has no
            home pose; or a xacro file is wrong.
    """
    own = config is None
    name, described = _described(robot, config)
    files = described | _exports(name, described, OUR_MANIFEST if own else {})
    return files | shared_xacro(robot) if own else files


def temporary_description(robot: str, config: Path | str) -> Path:
    """Write the description of a packaged robot with other parameters to a folder that lasts as long as Python.

    It has the URDF, which is returned, the closures file, the SRDF and a copy of the parameter file, named by its path
    or as one beside the robot's own.

    Raises:
        UnknownRobotError: no such robot comes with the package.
        DescriptionError: see :func:`description_files`.
    """
    config = find_parameters(robot, config)
    name, described = _described(robot, config)
    folder = Path(tempfile.mkdtemp(prefix="pm3dof_"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    for path, text in described.items():
        write_text_atomically(folder / path, text)
    whole = yaml.safe_dump(read_parameters(config), sort_keys=False)
    write_text_atomically(folder / "config" / f"{name}.yaml", whole)
    return folder / "urdf" / f"{name}.urdf"


def _described(robot: str, config: Path | str | None) -> tuple[str, dict[str, str]]:
    """Return the name of the robot, and the texts of URDF, closures file and SRDF by their paths."""
    if robot not in robot_names():
        raise UnknownRobotError(robot, robot_names())
    folder = robots_directory() / f"{robot}{DESCRIPTION_SUFFIX}"
    config = Path(config).absolute() if config is not None else folder / "config" / f"{robot}.yaml"
    read_quantities(config)
    parameters = read_parameters(config)
    name = parameters.get("name")
    if not isinstance(name, str):
        raise DescriptionError(config, "name", f"expected the name of the robot, not {name}")
    with tempfile.TemporaryDirectory() as temporary:
        whole = write_text_atomically(Path(temporary) / config.name, yaml.safe_dump(parameters, sort_keys=False))
        try:
            urdf = expand_xacro(folder / "xacro" / f"{robot}.urdf.xacro", {"config": str(whole)})
            closures = closures_text(folder / "xacro" / f"{robot}.closures.xacro", whole)
        except DescriptionError as error:
            problem = error.expected.removeprefix(f"{whole}: ")
            if problem == error.expected:
                raise
            element, _, expected = problem.partition(": ")
            raise DescriptionError(config, element, expected) from error
        srdf = srdf_text(folder / "xacro" / f"{robot}.srdf.xacro", whole, urdf, closures)
    return name, {f"urdf/{name}.urdf": urdf, f"urdf/{name}.closures.yaml": closures, f"srdf/{name}.srdf": srdf}


def shared_xacro(robot: str) -> dict[str, str]:
    """Return the xacro files that a robot shares with another one, so that its folder is a package by itself."""
    folder = robots_directory() / f"{robot}{DESCRIPTION_SUFFIX}" / "xacro"
    texts = [path.read_text(encoding="utf-8") for path in folder.glob("*.xacro")]
    included = sorted({found for text in texts for found in _SHARED.findall(text)})
    return {f"xacro/{path}": _shared_copy(name) for path, name in included}


def _shared_copy(name: str) -> str:
    (original,) = robots_directory().glob(f"*{DESCRIPTION_SUFFIX}/xacro/{name}")
    text = original.read_text(encoding="utf-8").removeprefix('<?xml version="1.0"?>\n')
    return _COPIED.format(folder=original.parents[1].name, name=name) + text


def _exports(name: str, described: dict[str, str], manifest: Mapping[str, str]) -> dict[str, str]:
    with tempfile.TemporaryDirectory() as folder:
        for path, text in described.items():
            write_text_atomically(Path(folder) / path, text)
        robot = read_robot(Path(folder) / "urdf" / f"{name}.urdf")
        exports: dict[str, str] = {}
        for kind in _FOLDERS:
            try:
                exports |= {f"{kind}/{path}": text for path, text in exported_files(robot, kind).items()}
            except DescriptionError as error:
                _logger.warning("%s: no %s: %s: %s", name, kind, error.element, error.expected)
        return exports | ros_files(robot, **manifest)


def same_but_rounding(text: str, other: str) -> bool:
    """Tell whether two texts differ in nothing but the last digits of numbers, as two computers may."""
    words, others = (_WORDS.split(words) for words in (text, other))
    return len(words) == len(others) and all(map(_same_word, words, others))


def _same_word(word: str, other: str) -> bool:
    if word == other:
        return True
    try:
        return math.isclose(float(word), float(other), rel_tol=1e-12, abs_tol=1e-12)
    except ValueError:
        return False
