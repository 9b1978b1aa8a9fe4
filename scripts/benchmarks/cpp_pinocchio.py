"""Jacobians by Pinocchio in C++, if a compiler and Eigen's headers are available: a reference for benchmarks."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import pinocchio as pin

from pm3dof_pin.kinematics.poses import Poses

SOURCE = Path(__file__).with_name("cpp") / "constraint_jacobians.cpp"
DEFINITIONS = (  # those that Pinocchio's own build files require of its users
    "BOOST_MPL_LIMIT_LIST_SIZE=30",
    "BOOST_MPL_LIMIT_VECTOR_SIZE=30",
    "BOOST_MPL_CFG_NO_PREPROCESSED_HEADERS",
    "BOOST_FUSION_INVOKE_MAX_ARITY=12",
    "PINOCCHIO_ENABLE_TEMPLATE_INSTANTIATION",
)


@cache
def _program() -> Path | str:
    """Return the compiled program, or the reason why there is none."""
    compiler = shutil.which("g++") or shutil.which("clang++")
    eigen = next((p for p in (Path("/usr/include/eigen3"), Path("/opt/homebrew/include/eigen3")) if p.is_dir()), None)
    prefix = Path(pin.__file__).parents[4]
    if compiler is None or eigen is None or not (prefix / "include" / "pinocchio").is_dir():
        return "needs a C++ compiler, Eigen's headers (libeigen3-dev) and a pin wheel with headers"
    binary = Path(tempfile.mkdtemp()) / "constraint_jacobians"
    command = [compiler, "-O3", "-DNDEBUG", "-std=c++17", str(SOURCE), *(f"-D{name}" for name in DEFINITIONS)]
    command += [f"-I{prefix / 'include'}", f"-I{eigen}", f"-L{prefix / 'lib'}", f"-Wl,-rpath,{prefix / 'lib'}"]
    command += ["-lpinocchio_default", "-lboost_serialization", "-o", str(binary)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return binary if done.returncode == 0 else f"does not compile: {done.stderr.strip().splitlines()[-1]}"


def jacobians_microseconds(poses: Poses) -> float | str:
    """Time joint, tool and constraint Jacobians by C++ Pinocchio, one thread.

    Args:
        poses: solved poses in one dimension.

    Returns:
        Microseconds a pose; or the reason why they were not measured.
    """
    binary = _program()
    if isinstance(binary, str):
        return binary
    robot = poses.robot
    lines = [f"{robot.tool_frame_id} {len(robot.closures)}"]
    for loop in robot.closures:
        first, second = (robot.model.frames[robot.frame_id(name)] for name in (loop.frame_a, loop.frame_b))
        lines.append(f"{first.parentJoint} {second.parentJoint} {3 if loop.type == '3d' else 6}")
        lines += [_placement(first.placement), _placement(second.placement)]
    lines.append(str(len(poses)))
    lines += [" ".join(map(repr, row)) for row in poses.q.tolist()]
    with tempfile.TemporaryDirectory() as folder:
        model, data = Path(folder) / "model", Path(folder) / "data"
        robot.model.saveToText(str(model))
        data.write_text("\n".join(lines), encoding="utf-8")
        done = subprocess.run([str(binary), str(model), str(data)], capture_output=True, text=True, check=True)
    return float(done.stdout.split()[0]) / 1e3


def _placement(placement: pin.SE3) -> str:
    rows = [[*row, shift] for row, shift in zip(placement.rotation.tolist(), placement.translation, strict=True)]
    return "\n".join(" ".join(repr(float(number)) for number in row) for row in rows)
