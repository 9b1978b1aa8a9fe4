"""What the sliders of the page need: the numbers of a tripod, and the tree of the URDF that they move.

The page computes what a slider's pose needs by itself, in closed form. It may do so for what was drawn with the
tripod's own springs and weight, and for nothing else; here it is decided what that is.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pm3dof_pin.chapter.elastic_stiffness import elastic_stiffness, spring_contributions
from pm3dof_pin.chapter.kinematics import joint_positions
from pm3dof_pin.chapter.limits import limit_violations
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.elastic.indices import Motion, OtherMotions
from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.typing import Array
from pm3dof_pin.viewer import colours, ellipsoids
from pm3dof_pin.viewer.arrows import joint_axis
from pm3dof_pin.viewer.bodies import Body
from pm3dof_pin.viewer.ellipsoids import Quantity
from pm3dof_pin.viewer.panel import outside_limits
from pm3dof_pin.viewer.scene import Json, Scene, column_major

SLIDERS = ("theta_x [deg]", "theta_y [deg]", "z_e [m]")

_CLOSED = 1e-9  # [m]
_SAME = 1e-6  # relative difference of what the page may go on with
_TILT_STEP = 0.1  # of the sliders [deg]
_HEIGHT_STEP = 0.0005  # [m]
_TILT_MARGIN = 10.0  # by how much the sliders go beyond the limits of the platform's joint [deg]


class Sliders:
    """Sliders for the motions of a tripod: tilts about x and y, and the height.

    Args:
        tripod: the machine in closed form.
        mechanism: the same machine as a tree with loop closures.

    Raises:
        InvalidValueError: they are not one machine.
    """

    def __init__(self, tripod: Tripod, mechanism: Robot) -> None:
        require_same_machine(tripod, mechanism)
        self._tripod = tripod
        self._mechanism = mechanism

    def pose(self, configuration: Configuration) -> Array:
        """Return (theta_x, theta_y, z_e) of a configuration, shape=(3,) [rad, rad, m]."""
        names = ("platform_x_joint", "platform_y_joint", "passive_slider_joint")
        zero = np.array([0.0, 0.0, self._tripod.height_home])
        return zero + [configuration.joint_position(name) for name in names]

    def put(self, scene: Scene, configuration: Configuration) -> None:
        """Put the sliders and a button for home into a scene, or set them to a configuration."""
        theta_x, theta_y, z_e = self.pose(configuration)
        values = [round(float(np.degrees(theta_x)), 9), round(float(np.degrees(theta_y)), 9), float(z_e)]
        factors = ("Math.PI / 180", "Math.PI / 180", "1")
        for index, (least, greatest, step) in enumerate(self._ranges()):
            callback = f"(value) => pm3dof.slide({index}, value * {factors[index]})"
            scene.set_slider(SLIDERS[index], callback, values[index], least, greatest, step)
        scene.set_button("home", "() => pm3dof.home()")

    def note(self, configuration: Configuration) -> tuple[list[str], list[str]]:
        """Return what is said of a configuration: where it is, and which limits it breaks."""
        pose = self.pose(configuration)
        theta_x, theta_y, z_e = pose
        travels = configuration.actuated_positions + self._tripod.parameters.slider_home
        degrees = [round(float(np.degrees(angle)), 1) + 0.0 for angle in (theta_x, theta_y)]  # zero has no sign
        where = f"θx {degrees[0]:.1f}°, θy {degrees[1]:.1f}°, z {z_e:.4f} m"
        listed = ", ".join(f"{1000.0 * travel:.2f}" for travel in travels)
        lines = [where.replace("-", "\u2212"), f"sliders at {listed} mm"]
        try:
            broken = limit_violations(self._tripod, pose)
        except UnreachablePoseError as error:  # of joints put together by hand
            return lines, [str(error)]
        return lines, outside_limits(map(str, broken))

    def machine_data(self, bodies: tuple[Body, ...]) -> Json:
        """Return the numbers of the machine as the page's closed form takes them.

        Args:
            bodies: what is drawn of it.
        """
        tripod, mechanism, p = self._tripod, self._mechanism, self._tripod.parameters
        return {
            "legs": _leg_table(tripod),
            "bounds": tripod.bounds.tolist(),
            "springs": [
                p.actuator_stiffness,
                p.link_stiffness,
                p.bending_stiffness,
                p.torsional_stiffness,
                tripod.clamp_height,
            ],
            "masses": {"slider": p.slider_mass, "link": p.link_mass, "platform": p.platform_mass + p.passive_leg_mass},
            "home": tripod.home.tolist(),
            "home_height": tripod.height_home,
            "home_travel": p.slider_home,
            "joints": _joints(mechanism),
            "closures": [
                [_point(mechanism, loop.frame_a), _point(mechanism, loop.frame_b)] for loop in mechanism.closures
            ],
            "bodies": [
                {"path": body.path, "joint": body.joint, "placement": column_major(body.placement)} for body in bodies
            ],
            "sliders": list(SLIDERS),
        }

    def live_ellipsoid(
        self,
        block: Array,
        configuration: Configuration,
        *,
        kind: Motion,
        of: Quantity,
        others: OtherMotions,
        scale: float,
    ) -> Json | None:
        """Return how the page goes on with an ellipsoid at the tool, if it is that of the tripod's own springs.

        Args:
            block: what is drawn, shape=(3, 3).
            configuration: where.
            kind: see :meth:`Viewer.stiffness_ellipsoid <pm3dof_pin.viewer.viewer.Viewer.stiffness_ellipsoid>`.
            of: see there.
            others: see there.
            scale: length of a semi-axis for a value of 1 [m per unit].
        """
        stiffness = elastic_stiffness(self._tripod, self.pose(configuration), on_failure="nan")
        if not np.all(np.isfinite(stiffness)):
            return None
        own = ellipsoids.block(stiffness, None, kind, of, others)
        if np.abs(block - own).max() > _SAME * np.abs(own).max():
            return None
        unit = ellipsoids.UNITS[of, kind]
        return {"kind": "ellipsoid", "motion": kind, "of": of, "others": others, "scale": scale, "unit": unit}

    def live_forces(self, forces: Array, configuration: Configuration, *, scale: float, width: float) -> Json | None:
        """Return how the page goes on with actuator forces, if they hold the tripod's own weight.

        Args:
            forces: what is drawn, shape=(number of legs,) [N].
            configuration: where.
            scale: length of an arrow for 1 N [m].
            width: half width of an arrow [m].
        """
        from pm3dof_pin.dynamics.statics import holding_forces

        if self._tripod.leg_count != 3 or not self._has_its_masses():
            return None
        own = holding_forces(configuration).actuator_forces
        if np.abs(forces - own).max() > _SAME * np.abs(own).max():
            return None
        return {"kind": "forces", "scale": scale, "width": width}

    def live_shares(
        self, names: Sequence[str], shares: Sequence[float], configuration: Configuration, load: Array
    ) -> Json | None:
        """Return how the page goes on with the legs' shares, if they are those of the tripod's own springs.

        Args:
            names: names of the legs.
            shares: what is drawn, leg after leg and the passive one last.
            configuration: where.
            load: the load at the tool, shape=(6,) [N, N m].
        """
        from pm3dof_pin.elastic.shares import shares as shares_of_springs

        legs = self._tripod.leg_count
        if len(shares) != legs + 1:
            return None
        parts = shares_of_springs(spring_contributions(self._tripod, self.pose(configuration)), load)
        own = np.append(parts[:legs] + parts[legs : 2 * legs], parts[-1])
        if not np.abs(own - np.asarray(shares)).max() <= _SAME:
            return None
        stops = colours.stops(colours.SHARE_STOPS).tolist()
        return {"kind": "shares", "wrench": load.tolist(), "stops": stops, "names": list(names)}

    def _ranges(self) -> list[tuple[float, float, float]]:
        """Least, greatest and step of each slider [deg, deg, m]: beyond the limits, so that these can be seen."""
        tilt = round(float(np.degrees(self._tripod.parameters.universal_limit)) + _TILT_MARGIN)
        low, high = self._tripod.bounds[4:]
        least = round(0.01 * float(np.floor(100.0 * low)), 2)
        greatest = round(0.01 * float(np.ceil(100.0 * (high + 0.25 * (high - low)))), 2)
        return [(-tilt, tilt, _TILT_STEP), (-tilt, tilt, _TILT_STEP), (least, greatest, _HEIGHT_STEP)]

    def _has_its_masses(self) -> bool:
        p = self._tripod.parameters
        described = p.platform_mass + p.passive_leg_mass + p.leg_count * (p.slider_mass + p.link_mass)
        moving = sum(inertia.mass for inertia in list(self._mechanism.model.inertias)[1:])
        return bool(abs(described - moving) <= _SAME * described)


def require_same_machine(tripod: Tripod, mechanism: Robot) -> None:
    """Check that a closed form and a mechanism are one machine.

    Raises:
        InvalidValueError: their joints differ, or the closed form leaves loops of the mechanism open.
    """
    tilt = 0.3 * tripod.parameters.universal_limit
    for pose in (tripod.home, np.array([tilt, -tilt, tripod.height_home])):
        positions = joint_positions(tripod, pose)
        if set(positions) != set(mechanism.q_names):
            raise InvalidValueError("tripod", tripod.parameters.name, f"the tripod that {mechanism} is: joints differ")
        q = np.array([positions[name] for name in mechanism.q_names])
        residual = mechanism.configuration(q).closure_residual
        if residual > _CLOSED:
            expected = f"the tripod that {mechanism} is: its loops stay open by {residual:.1e} m"
            raise InvalidValueError("tripod", tripod.parameters.name, expected)


def _joints(mechanism: Robot) -> list[Json]:
    model = mechanism.model
    joints: list[Json] = [{"name": "universe", "parent": -1, "placement": column_major(np.eye(4))}]
    for joint in range(1, model.njoints):
        axis, turns = joint_axis(mechanism, joint)
        joints.append(
            {
                "name": model.names[joint],
                "parent": int(model.parents[joint]),
                "placement": column_major(model.jointPlacements[joint].homogeneous),
                "type": "revolute" if turns else "prismatic",
                "axis": axis.tolist(),
            }
        )
    return joints


def _point(mechanism: Robot, name: str) -> Json:
    frame = mechanism.model.frames[mechanism.frame_id(name)]
    return {"joint": int(frame.parentJoint), "placement": column_major(frame.placement.homogeneous)}


def _leg_table(tripod: Tripod) -> list[list[float]]:
    """Return the legs in the columns that the page's closed form has."""
    length = np.full((tripod.leg_count, 1), tripod.parameters.link_length)
    frames = np.swapaxes(tripod.link_frames, 1, 2).reshape(tripod.leg_count, 9)
    columns = [tripod.base_joints, tripod.guide_directions, tripod.platform_joints, length, tripod.socket_axes, frames]
    table: list[list[float]] = np.concatenate(columns, axis=1).tolist()
    return table
