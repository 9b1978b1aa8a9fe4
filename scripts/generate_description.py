"""Write the generated files of the descriptions: URDF, closures file, SRDF, and those for other tools.

Without arguments, those of every robot in robots/. With --config, those of a robot of your own that is of the family of
one of them: a tripod with other numbers, another hexapod.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from pm3dof_pin.description.robots import DESCRIPTION_SUFFIX, robot_names, robots_directory
from pm3dof_pin.export.description import description_files, same_but_rounding, shared_xacro
from pm3dof_pin.files import write_text_atomically


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", choices=robot_names(), help="only this one (pm3dof if there is an --output)")
    parser.add_argument("--config", type=Path, help="parameter file, laid out as that of the robot")
    parser.add_argument("--output", type=Path, help="folder of the description, of one robot (needed with --config)")
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 if a file is not as generated")
    arguments = parser.parse_args()
    if arguments.config is not None and arguments.output is None:
        parser.error("--config needs --output")
    if arguments.output is not None:
        files = description_files(arguments.robot or "pm3dof", config=arguments.config)
        return _outdated(arguments.output, files, arguments.check)
    robots = [arguments.robot] if arguments.robot else robot_names()
    folders = {robots_directory() / f"{robot}{DESCRIPTION_SUFFIX}": robot for robot in robots}
    # first the copies of shared files, which the rest is made from
    shared = [_outdated(folder, shared_xacro(robot), arguments.check) for folder, robot in folders.items()]
    made = [_outdated(folder, _made_from_them(robot), arguments.check) for folder, robot in folders.items()]
    return max(*shared, *made)


def _made_from_them(robot: str) -> dict[str, str]:
    shared = shared_xacro(robot)
    return {name: text for name, text in description_files(robot).items() if name not in shared}


def _outdated(folder: Path, files: dict[str, str], check: bool) -> int:
    """Write the files, or see whether one is not as generated: 1 if so."""
    outdated = 0
    for name, text in files.items():
        path = folder / name
        if not check:
            print(f"wrote {write_text_atomically(path, text)}")
        elif not path.is_file() or not same_but_rounding(path.read_text(encoding="utf-8"), text):
            print(f"not as generated: {path}")
            outdated = 1
    return outdated


if __name__ == "__main__":
    sys.exit(main())
