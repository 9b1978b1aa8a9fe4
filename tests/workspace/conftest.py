"""A machine whose sections are not all star-shaped."""

from __future__ import annotations

import dataclasses

import pytest

from pm3dof_pin.tripod import Tripod


@pytest.fixture(scope="session")
def hollow_tripod(tripod: Tripod) -> Tripod:
    """Long links, a short stroke and joints under the platform: tilted, it reaches lower than level."""
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
