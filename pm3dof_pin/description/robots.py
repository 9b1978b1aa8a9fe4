"""Finding robots: from a name, or the path of a URDF, to the files that describe it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pm3dof_pin.exceptions import DescriptionError, UnknownRobotError

DESCRIPTION_SUFFIX = "_description"
CLOSURES_SUFFIX = ".closures.yaml"
CLOSURES_FALLBACK = "robot.yaml"


@dataclass(frozen=True)
class RobotFiles:
    """The files of one robot.

    Attributes:
        name: name of the robot, or the stem of its URDF.
        urdf: the tree of bodies and joints.
        closures: the loop closures, actuated joints, tool frame and springs.
        srdf: named configurations and collision pairs, if there is such a file.
    """

    name: str
    urdf: Path
    closures: Path
    srdf: Path | None


def robots_directory() -> Path:
    """Return the folder of robot descriptions: inside the installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parents[1]
    installed = package / "robots"
    return installed if installed.is_dir() else package.parent / "robots"


def robot_names() -> list[str]:
    """Return the names of the robots that come with the package, sorted."""
    return sorted(
        folder.name.removesuffix(DESCRIPTION_SUFFIX) for folder in robots_directory().glob(f"*{DESCRIPTION_SUFFIX}")
    )


def find_robot(name_or_path: str | Path) -> RobotFiles:
    """Find the files of a robot.

    Args:
        name_or_path: a name of :func:`robot_names`, or the path of a URDF. Beside the URDF `x.urdf` stands its closures
            file, `x.closures.yaml` or `robot.yaml`; an SRDF `x.srdf` may stand beside it or in `../srdf`.

    Raises:
        UnknownRobotError: neither a known name nor an existing file.
        DescriptionError: the URDF has no closures file beside it.
    """
    if str(name_or_path) in robot_names():
        name = str(name_or_path)
        return _files_of(robots_directory() / f"{name}{DESCRIPTION_SUFFIX}" / "urdf" / f"{name}.urdf")
    urdf = Path(name_or_path)
    if not urdf.is_file():
        raise UnknownRobotError(str(name_or_path), robot_names())
    return _files_of(urdf)


def _files_of(urdf: Path) -> RobotFiles:
    closures = [urdf.with_name(urdf.stem + CLOSURES_SUFFIX), urdf.with_name(CLOSURES_FALLBACK)]
    srdfs = [urdf.with_suffix(".srdf"), urdf.parent.parent / "srdf" / f"{urdf.stem}.srdf"]
    found = next((path for path in closures if path.is_file()), None)
    if found is None:
        raise DescriptionError(
            urdf, "closures file", f"expected {closures[0].name} or {CLOSURES_FALLBACK} beside the URDF"
        )
    return RobotFiles(urdf.stem, urdf, found, next((path for path in srdfs if path.is_file()), None))
