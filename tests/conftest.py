"""Fixtures that several rooms share."""

from __future__ import annotations

import dataclasses
import os
from typing import TYPE_CHECKING

# as the command has it: the matrices are small, and threads inside BLAS only get in each other's way
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pytest

if TYPE_CHECKING:
    from pm3dof_pin.chapter import Tripod
    from pm3dof_pin.kinematics.robot import Robot


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
