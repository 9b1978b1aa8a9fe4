"""The description of a packaged robot with other parameters, generated from its xacro."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from pathlib import Path

from pm3dof_pin.description.expand import expand_together
from pm3dof_pin.description.parameters import find_parameters, read_parameters, read_quantities
from pm3dof_pin.description.robots import DESCRIPTION_SUFFIX, robot_names, robots_directory
from pm3dof_pin.description.yaml_file import yaml_text
from pm3dof_pin.exceptions import DescriptionError, UnknownRobotError
from pm3dof_pin.export.closures_file import closures_text
from pm3dof_pin.export.named_configurations import srdf_text
from pm3dof_pin.files import write_text_atomically


def temporary_description(robot: str, config: Path | str) -> Path:
    """Write the description of a packaged robot with other parameters to a folder that lasts as long as the process.

    It contains the URDF, which is returned, the closures file, the SRDF and a copy of the parameter file, which is
    given by its path, or by name if it is next to the robot's own.

    Raises:
        UnknownRobotError: no such robot comes with the package.
        DescriptionError: as :func:`packaged_description`.
    """
    config = find_parameters(robot, config)
    name, texts = packaged_description(robot, config)
    folder = Path(tempfile.mkdtemp(prefix="pm3dof_"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    for path, text in texts.items():
        write_text_atomically(folder / path, text)
    write_text_atomically(folder / "config" / f"{name}.yaml", yaml_text(read_parameters(config)))
    return folder / "urdf" / f"{name}.urdf"


def packaged_description(robot: str, config: Path | str | None) -> tuple[str, dict[str, str]]:
    """Return the name of a packaged robot, and the texts of its URDF, closures file and SRDF by path.

    Raises:
        UnknownRobotError: no such robot.
        DescriptionError: a quantity of the parameter file is missing or invalid, the geometry it describes has no home
            pose, or a xacro file is invalid.
    """
    if robot not in robot_names():
        raise UnknownRobotError(robot, robot_names())
    folder = robots_directory() / f"{robot}{DESCRIPTION_SUFFIX}"
    config = Path(config).absolute() if config is not None else folder / "config" / f"{robot}.yaml"
    read_quantities(config)
    parameters = read_parameters(config)
    name = parameters.get("name")
    if not isinstance(name, str):
        raise DescriptionError(config, "name", f"expected the name of the robot, not {name}")
    files = [folder / "xacro" / f"{robot}.{kind}.xacro" for kind in ("urdf", "closures", "srdf")]
    with tempfile.TemporaryDirectory() as temporary:
        whole = write_text_atomically(Path(temporary) / config.name, yaml_text(parameters))
        try:
            urdf, *others = expand_together(files, {"config": str(whole)})
            closures = closures_text(files[1], others[0])
        except DescriptionError as error:
            problem = error.expected.removeprefix(f"{whole}: ")
            if problem == error.expected:
                raise
            element, _, expected = problem.partition(": ")
            raise DescriptionError(config, element, expected) from error
        srdf = srdf_text(files[2], others[1], urdf, closures)
    return name, {f"urdf/{name}.urdf": urdf, f"urdf/{name}.closures.yaml": closures, f"srdf/{name}.srdf": srdf}
