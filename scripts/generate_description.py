"""Write the generated files of the descriptions: URDF, closures file, SRDF, and those for other tools.

Without arguments, those of every robot in robots/. With --config, those of your own robot of the same family as one of
them: a tripod with other numbers, another hexapod.
"""

from __future__ import annotations

import argparse
import logging
import math
import re
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

from pm3dof_pin.description.robots import DESCRIPTION_SUFFIX, robot_names, robots_directory
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.export.description import packaged_description
from pm3dof_pin.export.formats import exported_files
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


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", choices=robot_names(), help="only this one (pm3dof if there is an --output)")
    parser.add_argument("--config", type=Path, help="parameter file, with the layout of the robot's")
    parser.add_argument("--output", type=Path, help="folder of the description, of one robot (needed with --config)")
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 if a file is out of date")
    arguments = parser.parse_args()
    if arguments.config is not None and arguments.output is None:
        parser.error("--config needs --output")
    if arguments.output is not None:
        files = description_files(arguments.robot or "pm3dof", config=arguments.config)
        return _outdated(arguments.output, files, arguments.check)
    robots = [arguments.robot] if arguments.robot else robot_names()
    folders = {robots_directory() / f"{robot}{DESCRIPTION_SUFFIX}": robot for robot in robots}
    # first the copies of shared files, from which the rest is made
    shared = [_outdated(folder, shared_xacro(robot), arguments.check) for folder, robot in folders.items()]
    made = [_outdated(folder, _made_from_them(robot), arguments.check) for folder, robot in folders.items()]
    return max(*shared, *made)


def _made_from_them(robot: str) -> dict[str, str]:
    shared = shared_xacro(robot)
    return {name: text for name, text in description_files(robot).items() if name not in shared}


def _outdated(folder: Path, files: dict[str, str], check: bool) -> int:
    """Write the files, or check them: 1 if one differs from the generated one."""
    outdated = 0
    for name, text in files.items():
        path = folder / name
        if not check:
            print(f"wrote {write_text_atomically(path, text)}")
        elif not path.is_file() or not same_but_rounding(path.read_text(encoding="utf-8"), text):
            print(f"not as generated: {path}")
            outdated = 1
    return outdated


def description_files(robot: str = "pm3dof", *, config: Path | str | None = None) -> dict[str, str]:
    """Return the text of every generated file of a packaged robot's description, by its path in the folder.

    With another parameter file of the same layout, the xacro files that it shares with other robots are left out. A
    format that cannot express the robot, such as a moving body without mass, is left out and logged.

    Raises:
        UnknownRobotError: no such robot.
        DescriptionError: a quantity is missing from the parameter file or wrong, or the geometry it describes has no
            home pose; or a xacro file is wrong.
    """
    own = config is None
    name, texts = packaged_description(robot, config)
    files = texts | _exports(name, texts, OUR_MANIFEST if own else {})
    return files | shared_xacro(robot) if own else files


def shared_xacro(robot: str) -> dict[str, str]:
    """Return the xacro files that a robot shares with another one, so that its folder is self-contained."""
    folder = robots_directory() / f"{robot}{DESCRIPTION_SUFFIX}" / "xacro"
    texts = [path.read_text(encoding="utf-8") for path in folder.glob("*.xacro")]
    included = sorted({found for text in texts for found in _SHARED.findall(text)})
    return {f"xacro/{path}": _shared_copy(name) for path, name in included}


def _shared_copy(name: str) -> str:
    (original,) = robots_directory().glob(f"*{DESCRIPTION_SUFFIX}/xacro/{name}")
    text = original.read_text(encoding="utf-8").removeprefix('<?xml version="1.0"?>\n')
    return _COPIED.format(folder=original.parents[1].name, name=name) + text


def _exports(name: str, texts: dict[str, str], manifest: Mapping[str, str]) -> dict[str, str]:
    with tempfile.TemporaryDirectory() as folder:
        for path, text in texts.items():
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
    """Tell whether two texts differ only in the last digits of numbers, as between two computers."""
    words, others = (_WORDS.split(words) for words in (text, other))
    return len(words) == len(others) and all(map(_same_word, words, others))


def _same_word(word: str, other: str) -> bool:
    if word == other:
        return True
    try:
        return math.isclose(float(word), float(other), rel_tol=1e-12, abs_tol=1e-12)
    except ValueError:
        return False


if __name__ == "__main__":
    sys.exit(main())
