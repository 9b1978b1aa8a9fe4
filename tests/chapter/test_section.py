"""Stiffness sections against independently implemented equations, and the chapter's statements about its maps."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps.chapter_section import section_values, stiffness_section

MOTION = ("stiffness_theta_x", "stiffness_theta_y", "stiffness_t_z")
CONSTRAINED = ("stiffness_t_x", "stiffness_t_y", "stiffness_theta_z")


@pytest.fixture(scope="module")
def section(tripod: Tripod) -> xr.Dataset:
    return stiffness_section(tripod).dataset()


def _tilts(section: xr.Dataset) -> tuple[np.ndarray, np.ndarray]:
    theta_x, theta_y, _ = xr.broadcast(section.theta_x, section.theta_y, section.broken_limits)
    dims = section.broken_limits.dims
    return theta_x.transpose(*dims).values, theta_y.transpose(*dims).values


def _chapter(theta_x: float, theta_y: float, z_e: float) -> dict[str, float]:
    """The chapter's stiffness from Table 8.1 and (8.4)-(8.10) as printed, leg by leg."""
    l_b, l_e, length, z_0, gamma = 0.37425, 0.075, 0.353, 0.013, np.radians(50.0)
    c_x, s_x, c_y, s_y, c_g, s_g = (
        *(f(a) for a in (theta_x, theta_y) for f in (np.cos, np.sin)),
        np.cos(gamma),
        np.sin(gamma),
    )
    stiffness = np.zeros((3, 3))
    for angle in np.radians([-30.0, 90.0, -150.0]):
        c, s = np.cos(angle), np.sin(angle)
        e = np.array(
            [
                l_e * c * c_y + z_0 * s_y,
                l_e * c * s_x * s_y + l_e * s * c_x - z_0 * s_x * c_y,
                -l_e * c * c_x * s_y + l_e * s * s_x + z_e + z_0 * c_x * c_y,
            ]
        )
        j_i = np.array(
            [
                [0.0, -l_e * c * s_y + z_0 * c_y, 0.0],
                [
                    (l_e * c * s_y - z_0 * c_y) * c_x - l_e * s * s_x,
                    (l_e * c * c_y + z_0 * s_y) * s_x,
                    0.0,
                ],
                [
                    (l_e * c * s_y - z_0 * c_y) * s_x + l_e * s * c_x,
                    -(l_e * c * c_y + z_0 * s_y) * c_x,
                    1.0,
                ],
            ]
        )
        guide = np.array([-c_g * c, -c_g * s, s_g])
        # (8.7): the smaller root of |e - b - u guide| = length
        w = e - l_b * np.array([c, s, 0.0])
        u = np.roots([1.0, -2.0 * w @ guide, w @ w - length**2]).min()
        k = w - u * guide
        k_4 = k[0] * c_g * c + k[1] * c_g * s - k[2] * s_g
        j_a, j_t = k @ j_i / length, -k @ j_i / k_4
        stiffness += 1.5177e10 * np.outer(j_a, j_a) + 9.5950e7 * np.outer(j_t, j_t)
    free = z_e - 0.379178  # theory: z_b, to the known digits
    bending, twisting = 899.6698 / free**3, 697.4185 / free**2
    values = {
        "stiffness_theta_x": stiffness[0, 0] + bending,
        "stiffness_theta_y": stiffness[1, 1] + bending,
        "stiffness_t_z": stiffness[2, 2],
        "stiffness_t_x": bending / free**2,
        "stiffness_t_y": bending / free**2,
        "stiffness_theta_z": twisting,
    }
    return values | {"stiffness_global": sum(values.values()) / 6.0}


def test_values_at_random_poses(tripod: Tripod, section: xr.Dataset) -> None:
    theta_x, theta_y = _tilts(section)
    inside = np.argwhere(section.broken_limits.values == 0)
    for i, j in np.random.default_rng(5).permutation(inside)[:60]:
        expected = _chapter(theta_x[i, j], theta_y[i, j], float(section.z_e))
        for name, value in expected.items():
            # z_b is known to 4e-7 m, and T_x falls with the fifth power of the length
            assert section[name].values[i, j] == pytest.approx(value, rel=3e-5), name


def test_mask_and_gaps_against_pinocchio(mechanism: Robot, section: xr.Dataset) -> None:
    theta_x, theta_y = _tilts(section)
    generator = np.random.default_rng(6)
    for i, j in zip(*(generator.integers(size, size=150) for size in theta_x.shape), strict=True):
        pose = mechanism.solve([theta_x[i, j], theta_y[i, j], float(section.z_e)], engine="pinocchio")
        named = int(pose.broken_limits)
        assert section.broken_limits.values[i, j] == named
        for name in (*MOTION, *CONSTRAINED, "stiffness_global"):
            assert np.isnan(section[name].values[i, j]) == bool(named)


def test_motion_axes_are_stiffest_at_or_near_the_centre(tripod: Tripod, section: xr.Dataset) -> None:
    centre = {
        name: section_values(tripod, tripod.middle_height, name)(np.zeros((1, 2)))
        for name in section.data_vars
        if name != "broken_limits"
    }
    for name in MOTION:
        assert float(section[name].max()) < 1.06 * centre[name].item()
    for name in ("stiffness_t_z", "stiffness_global"):
        assert float(section[name].max()) == pytest.approx(centre[name].item(), rel=1e-12)


def test_constrained_axes_are_constant(section: xr.Dataset) -> None:
    for name in CONSTRAINED:
        assert float(section[name].max()) == float(section[name].min())


def test_t_z_is_stiffest_and_theta_z_weakest(section: xr.Dataset) -> None:
    inside = section.where(section.broken_limits == 0)
    for name in (*MOTION, *CONSTRAINED):
        if name != "stiffness_t_z":
            assert bool((inside.stiffness_t_z > inside[name]).where(section.broken_limits == 0, True).all())
        if name != "stiffness_theta_z":
            assert bool((inside.stiffness_theta_z < inside[name]).where(section.broken_limits == 0, True).all())


def test_global_map_has_the_shape_of_a_motion_axis(section: xr.Dataset) -> None:
    inside = section.broken_limits.values == 0
    correlation = np.corrcoef(section.stiffness_global.values[inside], section.stiffness_t_z.values[inside])[0, 1]
    assert correlation > 0.99


def test_mirror_symmetry(section: xr.Dataset) -> None:
    mirrored = section.isel(theta_y=slice(None, None, -1))
    for name in (*MOTION, *CONSTRAINED, "stiffness_global", "broken_limits"):
        np.testing.assert_allclose(section[name].values, mirrored[name].values, rtol=1e-12)


def test_default_section_is_that_of_the_table(section: xr.Dataset) -> None:
    assert section.sizes == {"theta_x": 81, "theta_y": 81}
    assert float(section.z_e) == pytest.approx(0.487333, abs=5e-7)


def test_the_dataset_explains_itself(section: xr.Dataset) -> None:
    assert section.attrs["machine"] == "pm3dof"
    assert section.attrs["model"] == "chapter"
    assert section.attrs["source"].startswith("pm3dof-pin ")
    units = {name: section[name].attrs["units"] for name in section.variables if name != "broken_limits"}
    assert {units[name] for name in ("stiffness_theta_x", "stiffness_theta_y", "stiffness_theta_z")} == {"N m/rad"}
    assert {units[name] for name in ("stiffness_t_x", "stiffness_t_y", "stiffness_t_z")} == {"N/m"}
    assert units["stiffness_global"] == "mixed"
    assert units["theta_x"] == units["theta_y"] == "rad"
    assert units["z_e"] == "m"
    assert all(section[name].attrs["long_name"] for name in section.variables)
    flags = section.broken_limits.attrs
    assert section.broken_limits.dtype == flags["flag_masks"].dtype == np.uint8
    words = dict(zip(flags["flag_meanings"].split(), flags["flag_masks"], strict=True))
    assert words == {"reach": 1, "stroke": 2, "universal": 4, "spherical": 8, "tilt": 16, "height": 32}


@pytest.mark.parametrize("z_e", [np.nan, np.inf, 0.379, [0.5]])
def test_bad_heights(tripod: Tripod, z_e: float) -> None:
    with pytest.raises(InvalidValueError, match="z_e"):
        stiffness_section(tripod, z_e=z_e)
