"""Write the tables of what each dialect says, by converting robots and reading them back.

    python scripts/compatibility_table.py closures > docs/tables/compatibility.txt
    python scripts/compatibility_table.py robots > docs/tables/robots_in_dialects.txt

The first is of a chain of nine joints, closed on its base by one closure of each type; the second of the robots here.
"""

from __future__ import annotations

import logging
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml

from pm3dof_pin.description.closure_types import CLOSURE_TYPES
from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.description.robots import robot_names
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.export.convert import convert_robot
from pm3dof_pin.kinematics.mobility import instantaneous_mobility
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.tolerances import SAME

DIALECTS = {"urdf": "URDF and closures file", "mjcf": "MJCF", "sdf": "SDFormat", "drake": "URDF for Drake"}

_SUFFIXES = {"urdf": ".urdf", "mjcf": ".xml", "sdf": ".sdf", "drake": ".urdf"}
COUPLINGS: dict[str, Mapping[str, Any]] = {
    "coupling, linear": {"joint": "joint1", "of": {"joint0": 0.5}},
    "coupling of several joints": {"joint": "joint1", "of": {"joint0": 0.5, "joint2": -1.0}},
    "coupling, polynomial": {"joint": "joint1", "of": {"joint0": [0.5, 0.3, -0.2, 0.1]}},
}
_LINK = """<link name="{0}"><inertial><origin xyz="0.05 0 0"/><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
"""
_JOINT = """<joint name="{name}" type="{kind}"><origin xyz="{xyz}" rpy="{rpy}"/>
<parent link="{parent}"/><child link="{child}"/><axis xyz="{axis}"/>
<limit lower="-3" upper="3" effort="10" velocity="1"/></joint>
"""
_RELATIVE = {
    "3d": pin.SE3(pin.utils.rotate("y", 0.5), np.zeros(3)),
    "hinge": pin.SE3(pin.utils.rotate("z", 0.6), np.zeros(3)),
    "universal": pin.SE3(pin.utils.rotate("x", 0.5) @ pin.utils.rotate("y", -0.3), np.zeros(3)),
    "prismatic": pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.1])),
    "cylindrical": pin.SE3(pin.utils.rotate("z", 0.6), np.array([0.0, 0.0, 0.1])),
    "planar": pin.SE3(pin.utils.rotate("z", 0.6), np.array([0.1, -0.1, 0.0])),
    "distance": pin.SE3(pin.utils.rotate("y", 0.5), np.array([0.1, 0.2, 0.2])),
}
"""Placements of frame b in frame a that each type permits."""


def write_chain(folder: Path, kind: str, couplings: tuple[Mapping[str, Any], ...] = ()) -> Path:
    """Write a chain of nine joints, closed on the base by one closure with axes of its own; return its URDF."""
    rng = np.random.default_rng(5)
    tree, at = _LINK.format("base"), pin.SE3.Identity()
    for k in range(9):
        rpy, xyz = rng.uniform(-1.5, 1.5, 3), rng.uniform(-0.2, 0.2, 3)
        at = at * pin.SE3(pin.rpy.rpyToMatrix(*rpy), xyz)
        tree += _LINK.format(f"link{k}")
        names = {"name": f"joint{k}", "parent": f"link{k - 1}" if k else "base", "child": f"link{k}"}
        joint = "prismatic" if k == 4 else "revolute"
        tree += _JOINT.format(**names, kind=joint, xyz=_text(xyz), rpy=_text(rpy), axis="0 1 0")
    row, relative = CLOSURE_TYPES[kind], _RELATIVE.get(kind, pin.SE3.Identity())
    axis = (0.6, 0.0, 0.8) if row.axis is not None else None
    axis_b = (0.0, 0.8, -0.6) if row.has_two_axes else None
    length = float(np.linalg.norm(relative.translation)) if row.is_distance else None
    loop = LoopClosure("seat", "tip", row.name, axis=axis, axis_b=axis_b, length=length)
    first, second = (pin.SE3(basis, np.zeros(3)) for basis in loop.bases or (np.eye(3), np.eye(3)))
    tip = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.2, 0.4), np.array([0.1, 0.05, 0.0]))
    seat = at * tip * second * relative.inverse() * first.inverse()
    for name, parent, place in (("seat", "base", seat), ("tip", "link8", tip)):
        tree += f'<link name="{name}"/>\n'
        rpy = pin.rpy.matrixToRpy(place.rotation)
        tree += _JOINT.format(
            **{"name": f"{name}_fixed", "kind": "fixed", "axis": "1 0 0", "parent": parent, "child": name},
            **{"xyz": _text(place.translation), "rpy": _text(rpy)},
        )
    path = folder / "chain.urdf"
    path.write_text(f'<robot name="chain">\n{tree}</robot>\n', encoding="utf-8")
    content = {
        "closed_loop": [["seat", "tip"]],
        "type": [kind],
        "name_mot": [f"joint{k}" for k in range(9 - row.size - len(couplings))],
        "closure_axes": [{"axis": list(axis), **({"axis_b": list(axis_b)} if axis_b else {})} if axis else None],
        "closure_lengths": [length],
        "couplings": [dict(coupling) for coupling in couplings],
        "tool_frame": "tip",
    }
    path.with_suffix(".closures.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def closures_table() -> str:
    """Return the table of closure types and couplings as Markdown."""
    lines = [f"| | {' | '.join(DIALECTS.values())} |", "|---" * (len(DIALECTS) + 1) + "|"]
    with tempfile.TemporaryDirectory() as folder:
        for kind in CLOSURE_TYPES:
            cells = [_closure_cell(Path(folder), kind, dialect) for dialect in DIALECTS]
            lines.append(f"| `{kind}` | {' | '.join(cells)} |")
        for name, coupling in COUPLINGS.items():
            cells = [_coupling_cell(Path(folder), coupling, dialect) for dialect in DIALECTS]
            lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _closure_cell(folder: Path, kind: str, dialect: str) -> str:
    """Return what the file alone says of a closure; with what is beside it, the closure must be what it was."""
    done = _converted(write_chain(folder, kind), dialect)
    if done is None:
        return "refused"
    whole, alone = done
    if [loop.type for loop in whole.closures] != [kind]:
        return "not read back"
    types = [loop.type for loop in alone.closures]
    if types == [kind]:
        return "yes"
    added = alone.model.njoints - whole.model.njoints
    return f"as {', '.join(types)}" + (f" + {added} joint{'s' if added > 1 else ''}" if added > 0 else "")


def _coupling_cell(folder: Path, coupling: Mapping[str, Any], dialect: str) -> str:
    if (done := _converted(write_chain(folder, "3d", (coupling,)), dialect)) is None:
        return "refused"
    return "yes" if done[1].couplings else "beside"


def robots_table() -> str:
    """Return the table of the robots here in every dialect, as Markdown."""
    lines = [f"| | loops, mobility | {' | '.join(DIALECTS.values())} |", "|---" * (len(DIALECTS) + 2) + "|"]
    machines = Path(__file__).parents[1] / "tests" / "machines"
    for name in (*robot_names(), *(str(path) for path in sorted(machines.iterdir()) if path.is_dir())):
        robot = Robot.load(name)
        kinds = Counter(loop.type for loop in robot.closures)
        loops = ", ".join(f"{count} {kind}" for kind, count in kinds.items()) or "none"
        cells = [f"{loops}; {instantaneous_mobility(robot.home).count}"]
        with tempfile.TemporaryDirectory() as folder:
            cells += [_robot_cell(robot, name, Path(folder) / f"as_{dialect}", dialect) for dialect in DIALECTS]
        lines.append(f"| {Path(name).name} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _robot_cell(robot: Robot, name: str, folder: Path, dialect: str) -> str:
    """Return what is lost of a robot, or that it comes back whole."""
    target = folder / f"robot{_SUFFIXES[dialect]}"
    try:
        losses = convert_robot(name, target, dialect=dialect).losses
        again = Robot.load(target)
    except DescriptionError as error:
        return f"refused: {error.expected}"
    if again.home.closure_residual > SAME:
        return f"does not close: {again.home.closure_residual:.1g}"
    if instantaneous_mobility(again.home).count != instantaneous_mobility(robot.home).count:
        return "another mobility"
    return "; ".join(losses) or "whole"


def _converted(path: Path, dialect: str) -> tuple[Robot, Robot] | None:
    """Return a robot as its converted file says it with what is beside it, and alone; None if it is refused."""
    target = path.parent / f"as_{dialect}" / f"robot{_SUFFIXES[dialect]}"
    shutil.rmtree(target.parent, ignore_errors=True)
    try:
        convert_robot(path, target, dialect=dialect)
    except DescriptionError:
        return None
    whole = Robot.load(target, lenient=True)
    if dialect == "urdf":
        return whole, whole
    for beside in target.parent.glob("*.closures.yaml"):
        beside.unlink()
    return whole, Robot.load(target, lenient=True)


def _text(numbers: Iterable[float]) -> str:
    return " ".join(repr(float(number)) for number in numbers)


if __name__ == "__main__":
    logging.disable(logging.WARNING)
    print({"closures": closures_table, "robots": robots_table}[sys.argv[1]](), end="")
