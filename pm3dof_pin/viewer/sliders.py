"""Data for the sliders of the page: the robot's coordinates and commands, its limits, and its tree.

The page computes the sliders' pose by itself, with the programs of :mod:`pm3dof_pin.viewer.page_programs`. It updates
only items that were drawn for the robot's own springs and weight; this module determines these, by the same programs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pm3dof_pin.capability.tool_capability import ToolCapability
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS, Coordinate, Unit
from pm3dof_pin.elastic.indices import OtherMotions
from pm3dof_pin.exceptions import SingularConfigurationError
from pm3dof_pin.kinematics.broken_limits import closure_names, limit_reading
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.programs.elimination import PIVOT
from pm3dof_pin.typing import Array, Matrix, Motion, Vector
from pm3dof_pin.viewer import colours, ellipsoids, polytopes
from pm3dof_pin.viewer.bodies import DrawnBody
from pm3dof_pin.viewer.ellipsoids import EllipsoidQuantity
from pm3dof_pin.viewer.labels import display_label
from pm3dof_pin.viewer.legs import about_body
from pm3dof_pin.viewer.page_programs import PagePrograms, placing_sets
from pm3dof_pin.viewer.plane import MotionSpace
from pm3dof_pin.viewer.polytopes import PolytopeQuantity
from pm3dof_pin.viewer.scene import Json, column_major

_SAME = 1e-6  # largest relative difference of items that the page may update
_MARGIN = 0.15  # of a slider beyond its range, relative to the range, so that limits are visible
_MAX_MARGIN = math.radians(15.0)  # of an angle
LONG_READING = 84
"""Characters from which numbers of a set are not repeated beside their sliders."""

_STEPS = 1000  # least number of steps of a slider
_DEGREES = 180.0 / math.pi


class Sliders:
    """Sliders for the coordinates and the commands of a robot."""

    def __init__(self, robot: Robot, programs: PagePrograms) -> None:
        self._robot = robot
        self._programs = programs
        self._sets = sets_of(robot)
        self._space = MotionSpace.from_configuration(robot.home)

    def machine_data(self, bodies: tuple[DrawnBody, ...]) -> Json:
        """Return the data about the robot and its drawn bodies that the page needs besides the programs."""
        robot = self._robot
        model = robot.model
        actuators = []
        for name in robot.actuated_joints:
            joint = int(model.getJointId(name))
            unit = "N" if robot.single_joint(name).translates else "N m"
            actuators.append({"joint": joint, "axis": robot.joint_axis(name).tolist(), "unit": unit})
        return {
            "home": robot.home.q.tolist(),
            "length": robot.characteristic_length,
            "sets": self._sets,
            "placements": model.njoints + (robot.tool_frame is not None),
            "tool": model.njoints if robot.tool_frame is not None else None,
            "bodies": [
                {
                    "path": body.path,
                    "joint": body.joint,
                    "placement": column_major(body.placement),
                    **about_body(robot, body, self._programs.springs),
                }
                for body in bodies
            ],
            "tool_joint": None if robot.tool_frame is None else robot.model.frames[robot.tool_frame_id].parentJoint,
            "commands": _numbers(robot, robot.command_coordinates, robot.home.commands)["numbers"],
            "sigmas": self._programs.sigmas.tolist(),
            "ellipsoids": [
                {"of": of, "motion": motion, "unit": unit} for (of, motion), unit in ellipsoids.UNITS.items()
            ],
            "explanations": ellipsoids.EXPLANATIONS,
            "basis": self._space.basis.T.tolist(),
            "translations": self._space.translations,
            "actuators": actuators,
            "joints": _joints(robot),
            "limits": {"joints": _joint_limits(robot), "swings": _swing_limits(robot)},
            "sound_pivot": PIVOT,
            "lengths": self._programs.spring_lengths,
            "has_closures": bool(robot.closures),
            "long_reading": LONG_READING,
        }

    def live_ellipsoid(
        self,
        block: Array,
        configuration: Configuration,
        *,
        kind: Motion,
        of: EllipsoidQuantity,
        others: OtherMotions,
        scale: float,
        length: float,
    ) -> Json | None:
        """Return how the page updates an ellipsoid at the tool, if it is that of the robot's own description.

        The block is drawn to a `scale` [m per unit]; axes far beyond `length` [m] change the scale. For the options see
        :meth:`Viewer.stiffness_ellipsoid <pm3dof_pin.viewer.viewer.Viewer.stiffness_ellipsoid>` and
        :meth:`~pm3dof_pin.viewer.viewer.Viewer.motion_ellipsoid`.
        """
        own = self._block(configuration, kind, of, others)
        if own is None or not np.abs(block - own).max() <= _SAME * np.abs(own).max():
            return None
        scaled = {"scale": scale, "length": length, "unit": ellipsoids.UNITS[of, kind]}
        return {"kind": "ellipsoid", "motion": kind, "of": of, "others": others, **scaled}

    def live_forces(
        self, forces: Array, configuration: Configuration, *, scale: float, length: float, width: float, unit: str
    ) -> Json | None:
        """Return how the page updates actuator forces [N, N m], if they hold the robot's own weight.

        Sizes as in :meth:`live_ellipsoid`; `width` is the half width of an arrow [m].
        """
        from pm3dof_pin.mechanism.loads import weight_scale

        if self._programs.holding is None:
            return None
        own = self._programs.holding(configuration.q)[:-1]
        reference = np.abs(own).max(initial=weight_scale(self._robot.model, 1e-6))
        if not np.abs(forces - own).max(initial=0.0) <= _SAME * reference:
            return None
        return {"kind": "forces", "scale": scale, "length": length, "width": width, "unit": unit}

    def live_polytope(
        self,
        at: ToolCapability,
        configuration: Configuration,
        *,
        of: PolytopeQuantity,
        kind: Motion,
        scale: float,
        length: float,
    ) -> Json | None:
        """Return how the page updates a polytope, by command, actuator and limit of each drive.

        None if there are redundant drives, or the page does not compute the same motions and weight. Sizes as in
        :meth:`live_ellipsoid`.
        """
        from pm3dof_pin.mechanism.loads import weight_scale

        robot, motion, holding = self._robot, self._programs.motion, self._programs.holding
        commands = [command.joint for command in robot.commands]
        if motion is None or set(commands) != {*at.drives} or at.tool_rates.shape[-1] != len(commands):
            return None
        groups, order = motion.program.split(motion(configuration.q)), [commands.index(drive) for drive in at.drives]
        if not np.abs(groups["drives"][:, order] - at.tool_rates).max() <= _SAME * np.abs(at.tool_rates).max():
            return None
        if of == "force":
            least = _SAME * np.abs(at.weight).max(initial=weight_scale(robot.model, 1e-6))
            if holding is None or not np.abs(holding(configuration.q)[:-1] - at.weight).max() <= least:
                return None
        limits = at.effort if of == "force" else at.speed
        drives = [
            {"command": command, "scale": robot.commands[command].scale, "actuator": actuator, "limit": float(limit)}
            for actuator, (command, limit) in enumerate(zip(order, limits, strict=True))
        ]
        sizes = {"scale": scale, "length": length, "unit": polytopes.polytope_unit(of, kind)}
        return {"kind": "polytope", "of": of, "motion": kind, "drives": drives, **sizes}

    def live_shares(
        self,
        legs: Sequence[Sequence[str]],
        configuration: Configuration,
        compliance: Matrix,
        load: Array,
    ) -> Json | None:
        """Return how the page updates the legs' shares in C, if C is that of the robot's own springs."""
        if not self._is_own(compliance, configuration):
            return None
        return {
            "kind": "shares",
            "wrench": load.tolist(),
            "stops": colours.stops(colours.SHARE_STOPS).tolist(),
            "names": [", ".join(springs) for springs in legs],
            "springs": [self._programs.spring_places(names) for names in legs],
        }

    def live_load(self, configuration: Configuration, compliance: Matrix, load: Array, *, length: float) -> Json | None:
        """Return how the page updates a load and its deflection, if C is that of the robot's own springs.

        `length` is that of an arrow [m].
        """
        if not self._is_own(compliance, configuration):
            return None
        return {"kind": "load", "wrench": load.tolist(), "length": length}

    def _is_own(self, compliance: Matrix, configuration: Configuration) -> bool:
        own = self._compliance(configuration)
        return own is not None and bool(np.abs(own - compliance).max() <= _SAME * np.abs(own).max())

    def _block(
        self, configuration: Configuration, kind: Motion, of: EllipsoidQuantity, others: OtherMotions
    ) -> Array | None:
        """Return the block of an ellipsoid as computed by the page; None if it is not."""
        try:
            if of == "stiffness" or of == "compliance":
                compliance = self._compliance(configuration)
                return None if compliance is None else ellipsoids.block(None, compliance, kind, of, others, self._space)
            motion, sigmas = self._programs.motion, self._programs.sigmas
            if motion is None or (of == "error" and not len(sigmas)):
                return None
            groups = motion.program.split(motion(configuration.q))
            scales = [command.scale for command in self._robot.commands]
            motions = groups["errors"] * sigmas if of == "error" else groups["drives"] / scales
            return ellipsoids.motion_block(motions, kind, of) if groups["sound"] == 1.0 else None
        except SingularConfigurationError:
            return None

    def _compliance(self, configuration: Configuration) -> Matrix | None:
        """Return C at the tool as computed by the page; None if it is not."""
        if self._programs.compliance is None:
            return None
        if any(configuration.q[length["index"]] + length["at_zero"] <= 0.0 for length in self._programs.spring_lengths):
            return None
        outputs = self._programs.compliance(configuration.q)
        return outputs[:-1].reshape(6, 6) if outputs[-1] == 1.0 else None


def sets_of(robot: Robot) -> list[Json]:
    """Return the sets of numbers that place a robot, for the page: coordinates, and commands if different.

    Each number has a `slider`: ends, range, step, digits and factor of the display, and the unit.
    """
    at_home = {"coordinates": robot.home_coordinates, "commands": robot.home.commands}
    sets = [
        {"title": name.capitalize(), "program": f"walk_{name}", **_numbers(robot, coordinates, at_home[name])}
        for name, coordinates in placing_sets(robot).items()
    ]
    return [entry for entry in sets if entry["numbers"]]


def reading(number: Json, value: float) -> str:
    """Format a number of a set like the page: "tilt about x 10.0°", nonbreaking, no minus on zero."""
    slider = number["slider"]
    text = f"{value * slider['factor']:z.{slider['digits']}f}".replace("-", "\u2212")
    return f"{number['label']}\u00a0{text}{slider['unit']}"


def _numbers(robot: Robot, coordinates: Sequence[Coordinate], values: Vector) -> Json:
    numbers, order = [], [k for k, c in enumerate(coordinates) if c.joint is not None]
    order += [k for k, c in enumerate(coordinates) if c.joint is None]
    for coordinate, value in zip(coordinates, values, strict=True):
        joint = None
        if coordinate.joint is not None:
            single = robot.single_joint(coordinate.joint)
            joint = {"index": single.q_index, "continuous": single.is_continuous}
        numbers.append(
            {
                "name": coordinate.name,
                "label": display_label(coordinate.name),
                "unit": coordinate.unit,
                "joint": joint,
                "tool": None if coordinate.tool is None else TOOL_COMPONENTS.index(coordinate.tool),
                "scale": coordinate.scale,
                "offset": coordinate.offset,
                "slider": _slider(robot, coordinate, float(value)),
            }
        )
    return {"numbers": numbers, "order": order}


def _slider(robot: Robot, coordinate: Coordinate, home: float) -> Json:
    """Return ends and step of a slider: slightly beyond the range; by default all angles, or lengths around home."""
    length = robot.characteristic_length
    is_angle = coordinate.unit == "rad"
    factor = _DEGREES if is_angle else 1.0
    lower, upper = robot.range_of(coordinate)
    least, greatest = (-math.pi, math.pi) if is_angle else (home - length, home + length)
    if math.isfinite(lower) and math.isfinite(upper):
        margin = min(_MARGIN * (upper - lower), _MAX_MARGIN if is_angle else math.inf)
        least, greatest = lower - margin, upper + margin
    step = ellipsoids.round_length(max(factor * (greatest - least), 1e-9) / _STEPS)
    digits = max(0, -math.floor(math.log10(step) + 1e-9))
    return {
        "factor": factor,
        "range": [lower, upper] if math.isfinite(upper - lower) else None,
        "unit": "°" if is_angle else "\u00a0m",
        "least": round(math.floor(factor * least / step) * step, digits),
        "greatest": round(math.ceil(factor * greatest / step) * step, digits),
        "step": round(step, digits),
        "digits": digits,
    }


def _joints(robot: Robot) -> list[Json]:
    """Return the parts of q: single numbers, pairs (cos, sin) and quaternions, by index and size."""
    parts: list[Json] = []
    for joint in list(robot.model.joints)[1:]:
        index, nq, nv = int(joint.idx_q), int(joint.nq), int(joint.nv)
        slides = joint.shortname().startswith("JointModelP")
        if nq == nv:
            parts += [{"index": index + k, "size": 1, "slides": slides} for k in range(nq)]
        else:  # positions, if any, precede rotations
            turns = 2 if nv in (1, 3) and nq == nv + 1 and nq != 4 else 4
            before = nq - turns
            parts += [{"index": index + k, "size": 1, "slides": True} for k in range(before)]
            parts.append({"index": index + before, "size": turns, "slides": False})
    return parts


def _joint_limits(robot: Robot) -> list[Json]:
    limits = []
    for index, name in enumerate(robot.q_names):
        lower, upper = float(robot.lower_limits[index]), float(robot.upper_limits[index])
        if math.isfinite(lower) and math.isfinite(upper):
            unit, scale, offset = limit_reading(robot, name)
            joint = next(k for k, each in enumerate(robot.model.joints) if 0 <= index - each.idx_q < each.nq)
            text = _limit_text(name, unit, scale, offset)
            limits.append({"index": index, "lower": lower, "upper": upper, "joint": joint, **text})
    return limits


def _swing_limits(robot: Robot) -> list[Json]:
    names = closure_names(robot)
    return [
        {
            "lower": 0.0,
            "upper": loop.swing_limit,
            "joint": robot.model.frames[robot.frame_id(loop.frame_a)].parentJoint,
            **_limit_text(names[loop.name], "rad"),
        }
        for loop in robot.closures
        if loop.swing_limit is not None
    ]


def _limit_text(name: str, unit: Unit, scale: float = 1.0, offset: float = 0.0) -> Json:
    factor, written, digits = (1.0, "m", 4) if unit == "m" else (_DEGREES, "deg", 2)
    return {"name": name, "unit": written, "factor": factor * scale, "offset": factor * offset, "digits": digits}
