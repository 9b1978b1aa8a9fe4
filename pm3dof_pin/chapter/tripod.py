"""The tripod as arrays: all that the closed form needs, computed once from the parameters."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import frozen, real_array
from pm3dof_pin.description.coordinates import Unit
from pm3dof_pin.description.parameters import TripodParameters
from pm3dof_pin.exceptions import InvalidValueError, ShapeError, UnreachablePoseError
from pm3dof_pin.kinematics.units import slip_in_range
from pm3dof_pin.typing import Array


class Tripod:
    """A tripod of n actuated prismatic-universal-spherical legs and a passive prismatic-universal leg.

    Read-only. The pose of the platform is (theta_x, theta_y, z_e) with R = Rx(theta_x) Ry(theta_y), (8.1)-(8.3).

    Attributes:
        parameters: the numbers of the machine.
        base_joints: B_i, base frame, shape=(n, 3) [m].
        guide_directions: e_i, unit vectors, base frame, shape=(n, 3).
        platform_joints: p_i, E_i in the platform frame, shape=(n, 3) [m].
        socket_axes: axes of the spherical joints, unit vectors, platform frame, shape=(n, 3).
        height_home: z_e of the home pose, level with every slider at the middle of its travel [m].
        height_min: z_e of the level platform with every slider at its lower stop [m].
        height_max: z_e of the level platform with every slider at its upper stop [m].
        clamp_height: z_b, where the middle platform clamps the passive leg [m].
        link_frames: axes x, y, z of the links at home as columns, base frame, shape=(n, 3, 3).
        bounds: u_min, u_max [m], universal, spherical [rad], lowest, highest z_e [m], shape=(6,).
    """

    def __init__(self, parameters: TripodParameters) -> None:
        p = self.parameters = parameters
        alpha, beta = p.base_joint_angles, p.platform_joint_angles
        zero = np.zeros_like(alpha)
        outward = np.stack([np.cos(alpha), np.sin(alpha), zero], axis=-1)
        platform_outward = np.stack([np.cos(beta), np.sin(beta), zero], axis=-1)
        heading = alpha + p.guide_heading
        plan = np.stack([np.cos(heading), np.sin(heading), zero], axis=-1)
        up = np.array([0.0, 0.0, 1.0])
        self.base_joints = p.base_radius * outward
        self.guide_directions = np.cos(p.guide_slope) * plan + np.sin(p.guide_slope) * up
        self.platform_joints = p.platform_radius * platform_outward + p.platform_joint_height * up
        inclination = p.spherical_axis_inclination
        self.socket_axes = np.cos(inclination) * up - np.sin(inclination) * platform_outward
        self.height_home = self.level_height(p.slider_home)
        self.height_min = self.level_height(p.slider_home - p.slider_stroke)
        self.height_max = self.level_height(p.slider_home + p.slider_stroke)
        self.clamp_height = self.height_min - p.clamp_depth_ratio * (self.height_max - self.height_min)
        margin = p.passive_slider_margin * (self.height_max - self.height_min)
        self.link_frames = self._link_frames()
        self.bounds = np.array(
            [
                p.slider_home - p.slider_stroke,
                p.slider_home + p.slider_stroke,
                p.universal_limit,
                p.spherical_limit,
                self.height_min - margin,
                self.height_max + margin,
            ]
        )
        for array in vars(self).values():
            if isinstance(array, np.ndarray):
                array.setflags(write=False)

    @classmethod
    def load(cls, path: Path | str | None = None) -> Tripod:
        """Read a tripod from its parameter file, by default the chapter's; DescriptionError if a number is wrong."""
        return cls(TripodParameters.load(path))

    @property
    def leg_count(self) -> int:
        """Number of actuated legs, n."""
        return self.parameters.leg_count

    @property
    def middle_height(self) -> float:
        """Middle of the stroke's height range for a level platform: the section of Table 8.3 [m]."""
        return 0.5 * (self.height_min + self.height_max)

    @cached_property
    def home(self) -> Array:
        """The home pose (0, 0, z_home) [rad, rad, m]."""
        return frozen(np.array([0.0, 0.0, self.height_home]))

    def level_height(self, slider: float) -> float:
        """Return z_e of the level platform with every slider at the same travel [m], platform above the sliders.

        Raises:
            UnreachablePoseError: the links do not reach the level platform, or not all at the same height.
        """
        difference = self.platform_joints - self.base_joints - slider * self.guide_directions
        radicand = self.parameters.link_length**2 - difference[:, 0] ** 2 - difference[:, 1] ** 2
        if np.any(radicand < 0.0):
            raise UnreachablePoseError(f"with the sliders at {slider:g} m the links do not reach the level platform")
        heights = np.sqrt(radicand) - difference[:, 2]
        if np.ptp(heights) > 1e-9:
            raise UnreachablePoseError(f"with the sliders at {slider:g} m the legs do not meet one level platform")
        return float(heights[0])

    def checked(self, poses: ArrayLike) -> Array:
        """Return poses as an array, shape=(..., 3).

        Raises:
            InvalidValueError: poses of another shape, not real, or apparently in degrees or millimetres.
        """
        array = real_array("poses", poses)
        if array.ndim == 0 or array.shape[-1] != 3:
            raise ShapeError("poses", array.shape, "(..., 3): theta_x, theta_y, z_e")
        self._require_units(array)
        return array

    def checked_modes(self, assembly_mode: ArrayLike) -> Array:
        """Return an assembly mode for each leg, shape=(n,); InvalidValueError unless -1 or +1, once or for each."""
        modes = real_array("assembly_mode", assembly_mode)
        if not np.all(np.abs(modes) == 1.0) or modes.shape not in ((), (self.leg_count,)):
            raise InvalidValueError(
                "assembly_mode", assembly_mode, f"-1 or +1, once or for each of {self.leg_count} legs"
            )
        return modes if modes.ndim > 0 else np.full(self.leg_count, modes)

    def _require_units(self, poses: Array) -> None:
        p = self.parameters
        ranges: tuple[tuple[str, Unit, float, float], ...] = (
            ("theta_x", "rad", *p.tilt_range),
            ("theta_y", "rad", *p.tilt_range),
            ("z_e", "m", self.height_min, self.height_max),
        )
        for (name, unit, lower, upper), column in zip(ranges, np.moveaxis(poses, -1, 0), strict=True):
            if slip := slip_in_range(column, unit, lower, upper):
                problem = f"= {column.reshape(-1)[slip.index]:.6g} looks like {slip.unit}"
                raise InvalidValueError(name, problem=problem, expected=slip.expected)

    def checked_pose(self, pose: ArrayLike) -> Array:
        """Return a single pose as an array, InvalidValueError unless shape=(3,)."""
        array = self.checked(pose)
        if array.ndim != 1:
            raise ShapeError("pose", array.shape, "(3,): theta_x, theta_y, z_e")
        return array

    def _link_frames(self) -> Array:
        sliders = self.base_joints + self.parameters.slider_home * self.guide_directions
        links = self.platform_joints + np.array([0.0, 0.0, self.height_home]) - sliders
        z = links / np.linalg.norm(links, axis=-1, keepdims=True)
        azimuth = np.arctan2(z[:, 1], z[:, 0])
        y = np.stack([-np.sin(azimuth), np.cos(azimuth), np.zeros_like(azimuth)], axis=-1)
        return np.stack([np.cross(y, z), y, z], axis=-1)
