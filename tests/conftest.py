"""Fixtures that several rooms share."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

# as the command has it: the matrices are small, and threads inside BLAS only get in each other's way
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pytest

if TYPE_CHECKING:
    from pm3dof_pin.chapter import Tripod
    from pm3dof_pin.kinematics.robot import Robot


@dataclasses.dataclass(frozen=True)
class Done:
    """What a command left: its exit status, and what it printed."""

    returncode: int
    stdout: str
    stderr: str


def run_command(*arguments: str, cwd: Path | None = None, merged: bool = False) -> Done:
    """Run `pm3dof` with arguments inside this process, which spares the imports.

    Args:
        arguments: as on the command line.
        cwd: folder to run it in.
        merged: whether messages come in `stdout` between the results, as on a terminal.
    """
    from pm3dof_pin.cli.app import main

    stdout, status = io.StringIO(), 0
    stderr = stdout if merged else io.StringIO()
    argv, sys.argv = sys.argv, ["pm3dof", *arguments]
    try:
        with (
            contextlib.redirect_stdout(stdout),
            contextlib.redirect_stderr(stderr),
            contextlib.chdir(cwd or Path.cwd()),
        ):
            main()
    except SystemExit as leaving:
        status = leaving.code if isinstance(leaving.code, int) else int(leaving.code is not None)
    finally:
        sys.argv = argv
    return Done(status, stdout.getvalue(), "" if merged else stderr.getvalue())


@pytest.fixture(scope="session")
def run() -> Callable[..., Done]:
    """Run `pm3dof`: see :func:`run_command`."""
    return run_command


@pytest.fixture(scope="session")
def answer() -> Callable[..., dict[str, Any]]:
    """Run `pm3dof` with --json, expecting an exit status, and return what it answers."""

    def read(*arguments: str, status: int = 0) -> dict[str, Any]:
        done = run_command(*arguments, "--json")
        assert done.returncode == status, done.stderr
        return json.loads(done.stdout)

    return read


@pytest.fixture(scope="session")
def tripod() -> Tripod:
    """The chapter's machine in closed form."""
    from pm3dof_pin.chapter import Tripod

    return Tripod.load()


@pytest.fixture(scope="session")
def hollow_tripod(tripod: Tripod) -> Tripod:
    """A machine whose sections are not all star-shaped.

    Long links, a short stroke and joints under the platform: tilted, it reaches lower than level.
    """
    from pm3dof_pin.chapter import Tripod

    return Tripod(
        dataclasses.replace(
            tripod.parameters,
            link_length=0.416,
            platform_radius=0.088,
            platform_joint_height=-0.083,
            guide_slope=1.1,
            slider_home=0.23,
            slider_stroke=0.036,
            spherical_limit=1.2,
            spherical_axis_inclination=1.0,
            universal_limit=1.32,
        )
    )


@pytest.fixture(scope="session")
def mechanism() -> Robot:
    """The chapter's machine from its URDF and closures file."""
    from pm3dof_pin.kinematics.robot import Robot

    return Robot.load("pm3dof")


@pytest.fixture(scope="session")
def reachable_poses(tripod: Tripod) -> np.ndarray:
    """10,000 random poses within every joint limit, shape=(10000, 3) [rad, rad, m]."""
    from pm3dof_pin.chapter.limits import broken_limits

    generator = np.random.default_rng(20100801)
    lowest, highest = np.array([-0.8, -0.8, 0.38]), np.array([0.8, 0.8, 0.6])
    candidates = generator.uniform(lowest, highest, (120_000, 3))
    reachable = candidates[broken_limits(tripod, candidates) == 0]
    assert len(reachable) >= 10_000
    return reachable[:10_000]
