"""A robot: a mechanism whose poses can be solved, from its coordinates, its commands or placements of its tool."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import finite_array, frozen, real_array, require_choice, require_count
from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS, Coordinate, tool_coordinates
from pm3dof_pin.description.physical_bounds import STIFFNESS
from pm3dof_pin.exceptions import (
    ConvergenceError,
    DescriptionError,
    InvalidValueError,
    ProgramError,
    ShapeError,
    UnreachablePoseError,
)
from pm3dof_pin.kinematics.actuation import independent_drives, motion_components
from pm3dof_pin.kinematics.assembly import CLOSURE_TOLERANCE, assemble
from pm3dof_pin.kinematics.careful import assemble_at
from pm3dof_pin.kinematics.grid import Grid
from pm3dof_pin.kinematics.mobility import generic_configuration, instantaneous_mobility
from pm3dof_pin.kinematics.pose_search import Solution, find_poses
from pm3dof_pin.kinematics.poses import REACH, Poses
from pm3dof_pin.kinematics.units import coordinate_periods, coordinate_scales, unit_slip
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.mechanism.mechanism import Mechanism
from pm3dof_pin.mechanism.robot_description import read_source
from pm3dof_pin.mechanism.tool_components import tool_components
from pm3dof_pin.typing import Array, Engine, Matrix, OnFailure, Vector

if TYPE_CHECKING:
    import yourdfpy

    from pm3dof_pin.kinematics.closing_programs import ProgramSource
    from pm3dof_pin.kinematics.continuation import Continuation

_logger = logging.getLogger(__name__)

_GREATEST = 1e12  # magnitude of a coordinate or command; beyond it arithmetic overflows
_HOME = "home"
_MANY = 32  # poses that justify a program
_CONTRADICTION = 1e-6  # least difference of contradicting commands of redundant drives [rad, characteristic lengths]


class LoadOptions(TypedDict, total=False):
    """Options of whatever loads a robot, see :meth:`Robot.load`."""

    tool_frame: str | None
    package_paths: Iterable[str | Path]
    xacro_args: Mapping[str, str] | None
    drive_stiffness: float | Mapping[str, float] | None
    characteristic_length: float | None
    engine: Engine
    threads: int | None


class Robot(Mechanism):
    """A mechanism with solvers: finds poses from coordinates, commands or placements of the tool.

    Poses are purely geometric: joint limits are not enforced; :attr:`Poses.broken_limits` reports violations.

    Args:
        model, closures: see :class:`~pm3dof_pin.mechanism.mechanism.Mechanism`, as for all further arguments.
        engine, threads: see :meth:`with_engine`; attributes of the same names.

    Example:
        >>> import pm3dof_pin as pm
        >>> robot = pm.load("pm3dof")
        >>> poses = robot.solve([0.1, -0.2, 0.5])
        >>> poses.commands.round(6)
        array([0.256293, 0.254515, 0.230511])
    """

    def __init__(
        self,
        model: pin.Model,
        closures: Iterable[LoopClosure] = (),
        *,
        engine: Engine = "program",
        threads: int | None = None,
        **described: Any,
    ) -> None:
        require_choice("engine", engine, Engine)
        if threads is not None:
            require_count("threads", threads)
        self.engine, self.threads = engine, threads  # before the rest, which keeps them in copies
        super().__init__(model, closures, **described)
        self._arguments |= {"engine": engine, "threads": threads}

    @classmethod
    def load(
        cls,
        source: str | Path | pin.Model | yourdfpy.URDF,
        *,
        tool_frame: str | None = None,
        package_paths: Iterable[str | Path] = (),
        xacro_args: Mapping[str, str] | None = None,
        drive_stiffness: float | Mapping[str, float] | None = None,
        characteristic_length: float | None = None,
        engine: Engine = "program",
        threads: int | None = None,
    ) -> Robot:
        """Load a robot by name, from its description, or from a model of another library.

        Example:
            >>> import pm3dof_pin as pm
            >>> pm.load("hexapod")
            Robot(hexapod: 24 joints, 6 actuated, 6 closures, tool O_e)

        Args:
            source: name of a robot, or path of a URDF, xacro, MJCF or closures file, or of a folder containing one, see
                :func:`~pm3dof_pin.description.robots.find_robot`. Or a `pinocchio.Model`, or a `yourdfpy.URDF`: these
                have no loops; `Robot(model, closures, actuated_joints=..., tool_frame=...)` closes them.
            tool_frame: tool frame, instead of the described one.
            package_paths: folders of ROS packages.
            xacro_args: values of the arguments of a xacro file, by name.
            drive_stiffness: see :meth:`with_drive_stiffness` [N/m, N m/rad].
            characteristic_length: see :class:`~pm3dof_pin.mechanism.mechanism.Mechanism` [m].
            engine: see :meth:`with_engine`.
            threads: see there.

        Raises:
            UnknownRobotError: there is no such robot.
            DescriptionError: a file is missing, unreadable or malformed.
            FrameNotFoundError: the tool or a closure refers to a frame that the tree does not have.
            JointNotFoundError: the closures file names a joint that the tree does not have.
            InvalidValueError: the source is none of these.
        """
        described = read_source(source, tool_frame=tool_frame, package_paths=package_paths, xacro_args=xacro_args)
        robot = cls(**described, characteristic_length=characteristic_length, engine=engine, threads=threads)
        return robot if drive_stiffness is None else robot.with_drive_stiffness(drive_stiffness)

    def with_drive_stiffness(self, stiffness: float | Mapping[str, float]) -> Robot:
        """Return the robot with springs at its drives, in place of joint springs that these have in the description.

        Such a spring is the drive with its transmission, as felt at the actuated joint. Drives without a spring are
        rigid.

        Example:
            >>> import pm3dof_pin as pm
            >>> robot = pm.load("linear_delta").with_drive_stiffness(1e7)
            >>> pm.compliance(robot, robot.home).shape
            (6, 6)

        Args:
            stiffness: of every actuated joint, or of those named [N/m for a prismatic joint, N m/rad for a revolute].

        Raises:
            InvalidValueError: a stiffness is not a positive number, or a joint is not actuated.
            DescriptionError: the robot has no actuated joints.
        """
        if not self.actuated_joints:
            raise DescriptionError(self.source, "actuated joints", "there are none to give a drive stiffness to")
        given = stiffness if isinstance(stiffness, Mapping) else dict.fromkeys(self.actuated_joints, stiffness)
        springs = []
        for name, value in given.items():
            if name not in self.actuated_joints:
                raise InvalidValueError("drive", name, f"one of {', '.join(self.actuated_joints)}")
            number = float(finite_array(f"drive stiffness of {name}", value, ()))
            if not 0.0 < number <= STIFFNESS.greatest:
                expected = f"a positive number of at most {STIFFNESS.greatest:g} N/m or N m/rad"
                raise InvalidValueError(f"drive stiffness of {name}", f"{number:g}", expected)
            unit = "N/m" if self.single_joint(name).translates else "N m/rad"
            springs.append({"name": name, "type": "joint", "joint": name, "stiffness": number, "unit": unit})
        others = [entry for entry in self.springs if not (entry.get("type") == "joint" and entry.get("joint") in given)]
        return self.replace(springs=[*others, *springs])

    def with_engine(self, engine: Engine, *, threads: int | None = None) -> Robot:
        """Return the same robot computed by another engine, in everything that is computed for it.

        Args:
            engine: "program", the robot's compiled program; or "pinocchio", Pinocchio pose by pose, the reference.
            threads: threads of compiled programs; the number of processors by default. No result depends on it.
        """
        return self.replace(engine=engine, threads=threads)

    @cached_property
    def home(self) -> Configuration:
        """The named configuration "home" or else all zeros, with its loops closed if possible nearby.

        In an open tree, joints whose limits exclude zero are put in the middle of their range, or at its end.
        The actuated joints keep their positions if the loops close that way. If no closed configuration is found, it is
        the described one: check its :attr:`Configuration.closure_residual`.
        """
        named = self.named_configurations.get(_HOME)
        described = self.configuration(self._zeros if named is None else named)
        if described.closure_residual <= CLOSURE_TOLERANCE:
            return described
        drives = {name: described.joint_position(name) for name in self.actuated_joints}
        for joints in (drives, {}):
            result = assemble(self, described, joints=joints)
            if result.converged:
                return result.configuration
        return described

    @property
    def _zeros(self) -> Vector:
        q = np.array(pin.neutral(self.model))
        lower, upper = self.lower_limits, self.upper_limits
        for joint in () if self.closures else list(self.model.joints)[1:]:
            ends = np.array([lower[joint.idx_q], upper[joint.idx_q]])
            if joint.nq == 1 and not ends[0] <= 0.0 <= ends[1]:
                q[joint.idx_q] = np.mean(ends) if np.isfinite(ends).all() else ends[np.isfinite(ends)][0]
        return q

    @cached_property
    def program_source(self) -> ProgramSource:
        """Source of the programs of this robot and its variants."""
        from pm3dof_pin.kinematics.closing_programs import ProgramSource

        return ProgramSource(self)

    @cached_property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """The independent numbers that place the tool.

        In order of precedence: those declared by the description; the tool's placement if it has six degrees of
        freedom; if there are more drives than degrees of freedom, as many components of the tool's placement as it has
        degrees of freedom; the commands.
        """
        if self.declared_coordinates:
            return self.declared_coordinates
        return self._tool_coordinates() or self.command_coordinates

    @cached_property
    def command_coordinates(self) -> tuple[Coordinate, ...]:
        """The commands, as coordinates."""
        return tuple(
            Coordinate(command.name, command.unit, joint=command.joint, offset=command.offset, scale=command.scale)
            for command in self.commands
        )

    @cached_property
    def home_coordinates(self) -> Vector:
        """Values of the coordinates at home, shape=(number of coordinates,) [m, rad]."""
        return self.at([self.home.q])[0].coordinates

    def configuration(self, q: ArrayLike) -> Configuration:
        """Return the read-only :class:`Configuration` at q, shape=(nq,) [m, rad]; its loops need not be closed."""
        return Configuration(self, q)

    def coordinate(self, name: str) -> Coordinate:
        """Return a coordinate by name; InvalidValueError if there is none of this name."""
        for coordinate in self.coordinates:
            if coordinate.name == name:
                return coordinate
        raise InvalidValueError("coordinate", name, f"one of {', '.join(c.name for c in self.coordinates)}")

    def range_of(self, coordinate: Coordinate) -> tuple[float, float]:
        """Return the declared range of a coordinate, or that of its joint; infinite if there is none [m, rad]."""
        lower, upper = -np.inf, np.inf
        if coordinate.joint is not None:
            joint = self.single_joint(coordinate.joint)
            ends = np.array([self.lower_limits[joint.q_index], self.upper_limits[joint.q_index]])
            if not joint.is_continuous:
                lower, upper = np.sort(coordinate.scale * ends + coordinate.offset)
        return (
            float(lower) if coordinate.lower is None else coordinate.lower,
            float(upper) if coordinate.upper is None else coordinate.upper,
        )

    def grid(self, **values: float | tuple[float, float, int]) -> Grid:
        """Return a product grid over coordinates; those not named stay at home.

        Args:
            values: by coordinate, (first, last, count) for a dimension of the grid, or one value [m, rad].

        Raises:
            InvalidValueError: an unknown coordinate, a range that is not two finite ends and a count of at least 1, or
                values that look like millimetres or degrees.
        """
        axes: dict[str, Array] = {}
        fixed = {c.name: float(v) for c, v in zip(self.coordinates, self.home_coordinates, strict=True)}
        for name, value in values.items():
            self.coordinate(name)
            fixed.pop(name)
            if isinstance(value, tuple):
                numbers = finite_array(f"range of {name}", value, (len(value),))
                if len(numbers) != 3 or numbers[2] % 1.0 or numbers[2] < 1.0:
                    raise InvalidValueError(f"range of {name}", value, "first, last and a count of at least 1")
                axes[name] = np.linspace(numbers[0], numbers[1], int(numbers[2]))
            else:
                fixed[name] = float(finite_array(name, value, ()))
            self._require_unit(self.coordinate(name), axes.get(name, fixed.get(name, ())))
        return Grid(self.coordinates, axes, fixed)

    def at(self, q: ArrayLike, *, engine: Engine | None = None) -> Poses:
        """Return the poses at joint configurations with closed loops.

        Args:
            q: joint configurations, NaN for unsolved poses, shape=(..., nq) [m, rad].
            engine: instead of the robot's. For a few poses it is Pinocchio.

        Raises:
            InvalidValueError: q is not numeric or has the wrong shape.
        """
        engine = self._engine(engine)
        positions = real_array("q", q)
        if positions.ndim == 0 or positions.shape[-1] != self.model.nq:
            raise ShapeError("q", positions.shape, f"(..., {self.model.nq})")
        rows = positions.reshape(math.prod(positions.shape[:-1]), self.model.nq)  # nq may be 0
        if engine == "pinocchio" or len(rows) < _MANY:
            return Poses(self, positions)
        from pm3dof_pin.kinematics.closing_programs import program_source

        try:
            outputs = program_source(self).checks(self).named(rows)
        except ProgramError as error:
            _logger.info("%s: poses are placed without programs: %s", self.name, error)
            return Poses(self, positions)
        missing = np.isnan(rows).any(axis=1)
        broken_limits = np.where(missing, REACH, outputs["broken"]).astype(np.uint32)
        transforms = outputs.get("transform")
        if transforms is not None:
            transforms[missing] = np.nan
        return Poses(self, rows, outputs["residual"], broken_limits, transforms).reshape(*positions.shape[:-1])

    def solve(
        self,
        values: Grid | ArrayLike,
        *,
        guess: Configuration | ArrayLike | None = None,
        on_failure: OnFailure = "raise",
        engine: Engine | None = None,
        threads: int | None = None,
    ) -> Poses:
        """Find the poses at values of the coordinates.

        Without a guess, a pose is found by continuation from home, which fixes the assembly mode. A serial arm has many
        solutions, and singular poses on the way to them: its poses are also tried from further starts.

        Args:
            values: a grid, or values in order of the coordinates, shape=(..., number of coordinates) [m, rad].
            guess: configurations to start from, shape=(nq,) or (..., nq).
            on_failure: "raise", or "nan" for unreachable poses.
            engine: instead of the robot's, see :meth:`with_engine`.
            threads: instead of the robot's.

        Raises:
            UnreachablePoseError: no closed configuration was found for a pose, and `on_failure` is "raise".
            InvalidValueError: values or guesses have the wrong shape, or are not finite and `on_failure` is "raise"; or
                all values of a coordinate look like millimetres or degrees, being far out of its range.
        """
        return self._solutions(self.coordinates, "coordinates", values, guess, on_failure, engine, threads)

    def forward(
        self,
        commands: ArrayLike,
        *,
        guess: Configuration | ArrayLike | None = None,
        on_failure: OnFailure = "raise",
        engine: Engine | None = None,
    ) -> Poses:
        """Find the poses at commands, shape=(..., number of commands) [m, rad], as :meth:`solve` at coordinates.

        Commands are counter readings of the drives; a guess selects the assembly mode. If there are more drives than
        degrees of freedom, independent ones place the mechanism, and the others must agree within 1e-6 rad or
        characteristic lengths.
        """
        return self._solutions(self.command_coordinates, "commands", commands, guess, on_failure, engine)

    def reach(
        self,
        placements: pin.SE3 | ArrayLike,
        *,
        guess: Configuration | ArrayLike | None = None,
        on_failure: OnFailure = "raise",
        engine: Engine | None = None,
    ) -> Poses:
        """Find poses that bring the tool to placements, as :meth:`solve` to coordinates.

        Placements are `pin.SE3` or homogeneous transforms of the tool in the base, shape=(..., 4, 4); or positions
        only, with free orientation, shape=(..., 3) [m]. A guess selects the assembly mode. Also raises DescriptionError
        without a tool frame, and InvalidValueError for a matrix that is not a placement.
        """
        array = real_array("placements", placements.homogeneous if isinstance(placements, pin.SE3) else placements)
        if array.shape[-2:] == (4, 4):
            _require_placements(array)
            values = tool_components(array)
        else:
            values = array
        components = TOOL_COMPONENTS if array.shape[-2:] == (4, 4) else TOOL_COMPONENTS[:3]
        return self._solutions(tool_coordinates(components), "tool placements", values, guess, on_failure, engine)

    def assemble(
        self, guess: Configuration | ArrayLike | None = None, *, joints: Mapping[str, ArrayLike] | None = None
    ) -> Configuration:
        """Close the loops near a guess.

        Args:
            guess: configuration to start from; the home configuration by default.
            joints: coordinates of joints to hold [m, rad]; shape=(joint's nq,) for a joint with several.

        Raises:
            ConvergenceError: no closed configuration was found.
            JointNotFoundError: a joint is not in the model.
            InvalidValueError: the guess or a coordinate is not finite or of the wrong shape.
        """
        result = assemble(self, self.home if guess is None else guess, joints=joints)
        if not result.converged:
            advice = "try a guess closer to an assembled configuration"
            if guess is None:
                advice = (
                    "define a configuration 'home' near an assembled one; pm3dof info names the loops that are open"
                )
            raise ConvergenceError("closing the loops", result.residual, "m or rad", result.steps, advice)
        return result.configuration

    def read(self, coordinates: tuple[Coordinate, ...], q: Array, transforms: Array | None = None) -> Array:
        """Return the coordinates at q, shape=(..., nq), as shape=(..., number of coordinates) [m, rad].

        Placements of the tool, shape=(..., 4, 4), are needed if a coordinate is one of its components.
        """
        tool = None if transforms is None else tool_components(transforms)
        columns = []
        for coordinate in coordinates:
            if coordinate.joint is None:
                assert coordinate.tool is not None
                assert tool is not None
                columns.append(tool[..., TOOL_COMPONENTS.index(coordinate.tool)])
                continue
            value = self.single_joint(coordinate.joint).coordinate(q)
            columns.append(coordinate.scale * value + coordinate.offset)
        return np.stack(columns, axis=-1) if columns else np.empty((*q.shape[:-1], 0))

    def _solutions(
        self,
        coordinates: tuple[Coordinate, ...],
        name: str,
        values: Grid | ArrayLike,
        guess: Configuration | ArrayLike | None,
        on_failure: OnFailure,
        engine: Engine | None,
        threads: int | None = None,
    ) -> Poses:
        require_choice("on_failure", on_failure, OnFailure)
        engine, threads = self._engine(engine), self.threads if threads is None else threads
        if threads is not None:
            require_count("threads", threads)
        names = ", ".join(coordinate.name for coordinate in coordinates)
        targets = real_array(name, values.values if isinstance(values, Grid) else values)
        if targets.ndim == 0 or targets.shape[-1] != len(coordinates):
            expected = f"(..., {len(coordinates)}): {names}"
            raise ShapeError(name, targets.shape, expected)
        if on_failure == "raise":
            finite_array(f"{name} ({names})", targets, targets.shape)
        if (np.abs(targets[np.isfinite(targets)]) > _GREATEST).any():
            raise InvalidValueError(f"{name} ({names})", targets, f"numbers of at most {_GREATEST:g}")
        if guess is None:  # iterates from a guess may be anywhere
            for coordinate, column in zip(coordinates, np.moveaxis(targets, -1, 0), strict=True):
                self._require_unit(coordinate, column)
        shape = targets.shape[:-1]
        starts = None if guess is None else self._starts(guess, shape)
        rows = targets.reshape(math.prod(shape), len(coordinates))
        placing = self._placing_drives if coordinates == self.command_coordinates else list(range(len(coordinates)))
        independent = tuple(coordinates[k] for k in placing)
        continuation = self.continuation(independent) if engine == "program" else None
        if continuation is not None and isinstance(values, Grid) and starts is None:
            found = continuation.march(values, threads)
        else:
            found = find_poses(self, independent, rows[:, placing], starts, continuation)
        contradictions = None
        if len(placing) < len(coordinates):
            contradictions = self._contradictions(found.q, rows)
            off = np.abs(contradictions / coordinate_scales(self, coordinates)).max(axis=1) > _CONTRADICTION
            found = Solution(np.where(off[:, None], np.nan, found.q))
        failed = np.flatnonzero(np.isnan(found.q[:, :1]).any(axis=-1))  # nq may be 0
        if failed.size and on_failure == "raise":
            index = "" if len(rows) == 1 else f" (the first of {failed.size} of {len(rows)} poses)"
            if contradictions is not None and np.isfinite(contradictions[failed[0]]).all():
                raise self._contradicting(rows[failed[0]], contradictions[failed[0]], index)
            raise self._unreachable(independent, rows[failed[0], placing], index)
        known: list[Any] = [values if values is None else frozen(values) for values in found]
        return Poses(self, *known).reshape(*shape)

    def _engine(self, engine: Engine | None) -> Engine:
        """Return the engine given, or else the robot's."""
        if engine is None:
            return self.engine
        require_choice("engine", engine, Engine)
        return engine

    def _require_unit(self, coordinate: Coordinate, values: ArrayLike) -> None:
        """Refuse values in another unit, see :func:`~pm3dof_pin.kinematics.units.unit_slip`."""
        if slip := unit_slip(self, coordinate, values):
            number = np.asarray(values, dtype=float).reshape(-1)[slip.index]
            problem = f"= {number:.6g} looks like {slip.unit}"
            raise InvalidValueError(coordinate.name, problem=problem, expected=slip.expected)

    def _starts(self, guess: Configuration | ArrayLike, shape: tuple[int, ...]) -> Matrix:
        """Return a guess for each pose of a batch, flat."""
        nq = self.model.nq
        starts = real_array("guess", guess.q if isinstance(guess, Configuration) else guess)
        if starts.shape not in ((nq,), (*shape, nq)):
            raise ShapeError("guess", starts.shape, f"({nq},) or {(*shape, nq)}")
        return np.broadcast_to(starts, (*shape, nq)).reshape(-1, nq)

    def _unreachable(self, coordinates: tuple[Coordinate, ...], target: Vector, which: str) -> UnreachablePoseError:
        """Return the error for a pose that was not found, with the residual of damped steps from home."""
        result = assemble_at(self, coordinates, target, self.home.q)
        pose = ", ".join(f"{c.name} = {v:.9g} {c.unit}" for c, v in zip(coordinates, target, strict=True))
        reason = f"residual {result.residual:.3e} m or rad"
        if result.converged:
            reason = "the loops close there only beyond a singular pose or in another assembly mode"
        message = f"{self.name}: no assembled configuration found at {pose}{which}: {reason}"
        return UnreachablePoseError(message, result.residual, reason)

    @cached_property
    def arm_reach(self) -> tuple[Vector, float] | None:
        """Sphere that the tool of an open chain of hinges cannot leave, its centre and radius [m]; None for others."""
        if self.closures or self.tool_frame is None:
            return None
        model, tool = self.model, self.model.frames[self.tool_frame_id]
        chain = list(model.supports[tool.parentJoint])[1:]
        if not chain or not all(model.joints[index].shortname().startswith("JointModelR") for index in chain):
            return None
        first, *links = (model.jointPlacements[index].translation for index in chain)
        lengths = [float(np.linalg.norm(link)) for link in (*links, tool.placement.translation)]
        return frozen(np.array(first)), sum(lengths)

    @cached_property
    def _placing_drives(self) -> list[int]:
        """The drives that place the mechanism: all of them, unless there are more than degrees of freedom."""
        first = self.prototype
        if first is not self and (first.closures, first.actuated_joints) == (self.closures, self.actuated_joints):
            return first._placing_drives
        if self.has_loops:
            try:
                if drives := independent_drives(generic_configuration(self.home)):
                    return drives
            except (ConvergenceError, InvalidValueError):
                pass  # the loops do not close: the solvers report it
        return list(range(len(self.commands)))

    def _contradictions(self, q: Matrix, commands: Matrix) -> Matrix:
        """Return the differences of the commands at q from those given, shape=(n, number of commands) [m, rad]."""
        coordinates = self.command_coordinates
        differences, turns = self.read(coordinates, q) - commands, coordinate_periods(self, coordinates)
        angles = np.isfinite(turns)
        differences[:, angles] -= turns[angles] * np.round(differences[:, angles] / turns[angles])
        return differences

    def _contradicting(self, commands: Vector, off: Vector, which: str) -> UnreachablePoseError:
        coordinates, placing = self.command_coordinates, self._placing_drives
        worst = int(np.argmax(np.abs(off / coordinate_scales(self, coordinates))))
        name, unit = coordinates[worst].name, coordinates[worst].unit
        reason = (
            f"{', '.join(coordinates[k].name for k in placing)} alone determine the pose, with {name} at "
            f"{commands[worst] + off[worst]:.9g} {unit}, not {commands[worst]:.9g}"
        )
        return UnreachablePoseError(f"{self.name}: the commands contradict each other{which}: {reason}", None, reason)

    def why_careful(self) -> str | None:
        """Return why poses are solved by Pinocchio, one by one; None if they are solved by programs."""
        solver = self._solver(self.coordinates)
        return solver if isinstance(solver, str) else None

    def continuation(self, coordinates: tuple[Coordinate, ...]) -> Continuation | None:
        """Return the solver for these coordinates by programs, or None if there is none and Pinocchio solves them."""
        solver = self._solver(coordinates)
        return None if isinstance(solver, str) else solver

    def _solver(self, coordinates: tuple[Coordinate, ...]) -> Continuation | str:
        """Return the solver for these coordinates by programs, or why there is none."""
        from pm3dof_pin.kinematics.continuation import Continuation  # a single pose by Pinocchio needs no compiler

        if self.model.nq == 0:
            return "it has no movable joints"
        if coordinates not in self._solvers:
            try:
                self._solvers[coordinates] = Continuation(self, coordinates)
            except ProgramError as error:
                _logger.info("%s: solved without programs: %s", self.name, error)
                self._solvers[coordinates] = str(error)
        return self._solvers[coordinates]

    @cached_property
    def _solvers(self) -> dict[tuple[Coordinate, ...], Continuation | str]:
        return {}

    def _tool_coordinates(self) -> tuple[Coordinate, ...]:
        """Return components of the tool's placement that describe a pose better than the commands, if any."""
        if self.tool_frame is None:
            return ()
        try:
            usual = generic_configuration(self.home)
            mobility = instantaneous_mobility(usual)
            if mobility.tool_mobility == len(TOOL_COMPONENTS):
                return tool_coordinates(TOOL_COMPONENTS)
            if not mobility.tool_mobility == mobility.actuator_rank.rank < len(self.commands):
                return ()
            components = motion_components(self.home)
            at_home = len(components) == mobility.tool_mobility
            return tool_coordinates(components if at_home else motion_components(usual))
        except (ConvergenceError, InvalidValueError):
            return ()


load = Robot.load


def _require_placements(matrices: Array) -> None:
    rotation = matrices[..., :3, :3]
    defect = np.abs(np.swapaxes(rotation, -1, -2) @ rotation - np.eye(3)).max(initial=0.0)
    if not defect <= 1e-9 or (np.linalg.det(rotation) < 0.0).any() or (matrices[..., 3, :] != [0, 0, 0, 1]).any():
        raise InvalidValueError("placement", matrices, "a rotation matrix, a position and the last row 0 0 0 1")
