"""A robot: a mechanism whose poses can be solved, from its coordinates, its commands or placements of its tool."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Mapping
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pm3dof_pin.arrays import finite_array, frozen, real_array, require_choice, require_count
from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS, Coordinate, tool_coordinates
from pm3dof_pin.description.description import Description
from pm3dof_pin.description.physical_bounds import STIFFNESS
from pm3dof_pin.description.yaml_file import naming_lines
from pm3dof_pin.exceptions import (
    ConvergenceError,
    DescriptionError,
    InvalidValueError,
    JointNotFoundError,
    PM3DofError,
    ProgramError,
    ShapeError,
    UnreachablePoseError,
)
from pm3dof_pin.kinematics.assembly import assemble
from pm3dof_pin.kinematics.branches import branches_of, not_closed, start_of
from pm3dof_pin.kinematics.grid import Grid, require_few
from pm3dof_pin.kinematics.placed_mechanism import PlacedMechanism
from pm3dof_pin.kinematics.pose_search import Solution, Solver, find_poses
from pm3dof_pin.kinematics.poses import REACH, Poses
from pm3dof_pin.kinematics.reference import Reference, assemble_at
from pm3dof_pin.kinematics.shared_commands import SharedCommands
from pm3dof_pin.kinematics.units import unit_slip
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.mechanism.robot_description import read_source
from pm3dof_pin.mechanism.tool_components import tool_components
from pm3dof_pin.typing import Array, Branch, Engine, Indices, Matrix, OnFailure, Vector

if TYPE_CHECKING:
    from types import ModuleType

    import mujoco
    import yourdfpy

    from pm3dof_pin.kinematics.continuation import Continuation

_logger = logging.getLogger(__name__)

_MAX_MAGNITUDE = 1e12  # magnitude of a coordinate or command; beyond it arithmetic overflows
_MANY = 32  # poses that justify a program
_CLOSE_BY = 1e-2  # steps from home that programs of imprecise loops must find [characteristic lengths, rad]


class LoadOptions(TypedDict, total=False):
    """Options of whatever loads a robot, see :meth:`Robot.load`."""

    tool_frame: str | None
    package_paths: Iterable[str | Path]
    xacro_args: Mapping[str, str] | None
    lenient: bool
    drives: Iterable[str] | None
    drive_stiffness: float | Mapping[str, float] | None
    hold_base: bool | None
    characteristic_length: float | None
    closure_tolerance: float | None
    engine: Engine
    threads: int | None


class Robot(PlacedMechanism):
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
        source: str | Path | Description | pin.Model | yourdfpy.URDF | mujoco.MjModel | mujoco.MjSpec | ModuleType,
        *,
        tool_frame: str | None = None,
        package_paths: Iterable[str | Path] = (),
        xacro_args: Mapping[str, str] | None = None,
        lenient: bool = False,
        closures: Iterable[Any] = (),
        drives: Iterable[str] | None = None,
        drive_stiffness: float | Mapping[str, float] | None = None,
        hold_base: bool | None = None,
        characteristic_length: float | None = None,
        closure_tolerance: float | None = None,
        engine: Engine = "program",
        threads: int | None = None,
    ) -> Robot:
        """Load a robot by name, from its description, or from a model of another library.

        Example:
            >>> import pm3dof_pin as pm
            >>> pm.load("hexapod")
            Robot(hexapod: 24 joints, 6 actuated, 6 closures, tool O_e)

        Args:
            source: name of a robot, or path of a URDF, xacro, MJCF, SDF or closures file, or of a folder containing
                one, see :func:`~pm3dof_pin.description.robots.find_robot`. Or a description, a `pinocchio.Model`, a
                `yourdfpy.URDF`, a `mujoco.MjModel` or `MjSpec`, or a module of robot_descriptions.
            tool_frame: tool frame, instead of the described one.
            package_paths: folders of ROS packages.
            xacro_args: values of the arguments of a xacro file, by name.
            lenient: whether elements that could carry a loop, a coupling or a drive, and are not understood, are only
                listed in `robot.description.unread` instead of being refused.
            closures: the loops of a `pinocchio.Model`: closures, or constraint models of Pinocchio.
            drives: the actuated joints, in the order of the commands, instead of the described ones.
            drive_stiffness: see :meth:`with_drive_stiffness` [N/m, N m/rad].
            hold_base: whether a floating base is fixed where the configuration `home` has it, so that the tool's
                stiffness is that against the base; by default with `drive_stiffness` only. Not for a `pinocchio.Model`.
            characteristic_length: see :class:`~pm3dof_pin.mechanism.mechanism.Mechanism` [m].
            closure_tolerance: largest closure error of closed loops, instead of the described one [m, rad].
            engine: see :meth:`with_engine`.
            threads: see there.

        Raises:
            UnknownRobotError: there is no such robot.
            DescriptionError: a file is missing, unreadable or malformed.
            FrameNotFoundError: the tool or a closure refers to a frame that the tree does not have.
            JointNotFoundError: the closures file names a joint that the tree does not have, or a drive is none.
            InvalidValueError: the source is none of these, or a drive is named twice.
        """
        described = read_source(
            source,
            tool_frame=tool_frame,
            package_paths=package_paths,
            xacro_args=xacro_args,
            lenient=lenient,
            hold_base=drive_stiffness is not None if hold_base is None else hold_base,
            closures=closures,
        )
        if closure_tolerance is not None:
            described["closure_tolerance"] = closure_tolerance
        if drives is not None:
            described |= _driven_by(drives, described)
        with naming_lines():
            robot = cls(**described, characteristic_length=characteristic_length, engine=engine, threads=threads)
        return robot if drive_stiffness is None else robot.with_drive_stiffness(drive_stiffness)

    def with_drive_stiffness(self, stiffness: float | Mapping[str, float]) -> Robot:
        """Return the robot with springs at its drives, in place of joint springs that these have in the description.

        Such a spring is the drive with its transmission, as felt at the actuated joint. Drives without a spring are
        rigid. If the description names no actuated joints, as SDF cannot, those with a given stiffness are.

        Args:
            stiffness: of every actuated joint, or of those named [N/m for a prismatic joint, N m/rad for a revolute].

        Raises:
            InvalidValueError: a stiffness is not a positive number, or a joint is not actuated.
            JointNotFoundError: the robot has no actuated joints, and no such joint.
            DescriptionError: the robot has no actuated joints, and none are named.
        """
        if not self.actuated_joints:
            if not isinstance(stiffness, Mapping):
                advice = "there are none to give a drive stiffness to: name them, --drives JOINT,.. (drives=[...]), "
                advice += "or as name_mot in a closures file"
                raise DescriptionError(self.source, "actuated joints", advice)
            return self.replace(actuated_joints=tuple(stiffness)).with_drive_stiffness(stiffness)
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
    def home_coordinates(self) -> Vector:
        """Values of the coordinates at home, shape=(number of coordinates,) [m, rad]."""
        return self.at([self.home.q])[0].coordinates

    def grid(self, **values: float | tuple[float, float, int]) -> Grid:
        """Return a product grid over coordinates; those not named stay at home.

        Args:
            values: by coordinate, (first, last, count) for a dimension of the grid, or one value [m, rad].

        Raises:
            InvalidValueError: an unknown coordinate, a range that is not two finite ends and a count of at least 1
                or too many, or values that look like millimetres or degrees.
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
                require_few(int(numbers[2]), 1)
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
            checks = program_source(self).checks(self)
            outputs = checks.named(rows)
        except ProgramError as error:
            _logger.info("%s: poses are placed without programs: %s", self.name, error)
            return Poses(self, positions)
        missing = np.isnan(rows).any(axis=1)
        broken_limits = np.where(missing, REACH, outputs["broken"]).astype(np.uint32)
        transforms = outputs.get("transform")
        if transforms is not None:
            transforms[missing] = np.nan
        branch: NDArray[np.int64] | None = None
        if "branch" in outputs:
            branch = np.where(missing, 0.0, outputs["branch"]).astype(np.int64)
            if self.prototype is not self:
                with suppress(PM3DofError):  # without a home of its own, its prototype's is the reference
                    branch ^= np.int64(checks.named(start_of(self)[None])["branch"][0])
        return Poses(self, rows, outputs["residual"], broken_limits, transforms, branch).reshape(*positions.shape[:-1])

    def solve(
        self,
        values: Grid | ArrayLike,
        *,
        guess: Configuration | ArrayLike | None = None,
        on_failure: OnFailure = "raise",
        branches: Branch = "home",
        engine: Engine | None = None,
        threads: int | None = None,
    ) -> Poses:
        """Find the poses at values of the coordinates.

        Without a guess, a pose is found by continuation from home. Poses beyond a serial or parallel singularity are on
        another branch and out of reach, see :mod:`pm3dof_pin.kinematics.branches`; a guess there, or a configuration
        "home" of the description, makes that branch the one that is reached. A serial arm has many solutions, and
        singular poses on the way to them: its poses are also tried from further starts. If it has more joints than
        coordinates, those that break limits are moved into them where that is found, unless there is a guess.

        Args:
            values: a grid, or values in order of the coordinates, shape=(..., number of coordinates) [m, rad].
            guess: configurations to start from, shape=(nq,) or (..., nq).
            on_failure: "raise", or "nan" for unreachable poses.
            branches: "home", that of home or of the guess; or "all", whatever the coordinates alone determine without
                passing a singularity of their own: poses beyond those of the drives are found too, and
                :attr:`Poses.branch` tells them apart.
            engine: instead of the robot's, see :meth:`with_engine`.
            threads: instead of the robot's.

        Raises:
            UnreachablePoseError: no closed configuration was found for a pose, and `on_failure` is "raise".
            ConvergenceError: the loops do not close at home.
            SingularConfigurationError: several branches meet at home.
            InvalidValueError: values or guesses have the wrong shape, or are not finite and `on_failure` is "raise"; or
                all values of a coordinate look like millimetres or degrees, being far out of its range.
        """
        return self._solutions(self.coordinates, "coordinates", values, guess, on_failure, engine, threads, branches)

    def forward(
        self,
        commands: ArrayLike,
        *,
        guess: Configuration | ArrayLike | None = None,
        on_failure: OnFailure = "raise",
        branches: Branch = "home",
        engine: Engine | None = None,
    ) -> Poses:
        """Find the poses at commands, shape=(..., number of commands) [m, rad], as :meth:`solve` at coordinates.

        Commands are counter readings of the drives; a guess selects the assembly mode. If there are more drives than
        degrees of freedom, all are met by least squares in rad and characteristic lengths, as equally stiff drives hold
        the tool; commands that differ from the pose's by more than 0.002 contradict each other. If there are fewer,
        joints are left free, and a pose near the start is one of many.

        Raises also SingularConfigurationError if the drives do not determine the pose, see
        :meth:`require_regular_drives`.
        """
        return self._solutions(
            self.command_coordinates, "commands", commands, guess, on_failure, engine, None, branches
        )

    def reach(
        self,
        placements: pin.SE3 | ArrayLike,
        *,
        guess: Configuration | ArrayLike | None = None,
        on_failure: OnFailure = "raise",
        branches: Branch = "home",
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
        return self._solutions(
            tool_coordinates(components), "tool placements", values, guess, on_failure, engine, None, branches
        )

    def assemble(
        self, guess: Configuration | ArrayLike | None = None, *, joints: Mapping[str, ArrayLike] | None = None
    ) -> Configuration:
        """Close the loops near a guess.

        Args:
            guess: configuration to start from; the home configuration by default.
            joints: coordinates of joints to hold [m, rad]; shape=(joint's nq,) for a joint with several.

        Raises:
            ConvergenceError: no closed configuration was found; or, with neither guess nor joints, several.
            JointNotFoundError: a joint is not in the model.
            InvalidValueError: the guess or a coordinate is not finite or of the wrong shape.
        """
        result = assemble(self, self.home if guess is None else guess, joints=joints)
        is_ambiguous = joints is None and self.home.closure_residual > self.closure_tolerance
        if guess is None and (is_ambiguous or not result.converged):
            raise not_closed(self, result)
        if not result.converged:
            advice = "try a guess closer to an assembled configuration"
            raise ConvergenceError("closing the loops", result.residual, "m or rad", result.steps, advice)
        if guess is None and joints is None and result.residual > 0.5 * self.home.closure_residual:
            return self.home  # as closed as the description permits; steps that gain nothing lead astray
        return result.configuration

    def _solutions(
        self,
        coordinates: tuple[Coordinate, ...],
        name: str,
        values: Grid | ArrayLike,
        guess: Configuration | ArrayLike | None,
        on_failure: OnFailure,
        engine: Engine | None,
        threads: int | None,
        branches: Branch,
    ) -> Poses:
        require_choice("on_failure", on_failure, OnFailure)
        require_choice("branches", branches, Branch)
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
        largest = np.abs(targets).max(initial=0.0)
        if not largest <= _MAX_MAGNITUDE and (np.abs(targets[np.isfinite(targets)]) > _MAX_MAGNITUDE).any():
            raise InvalidValueError(f"{name} ({names})", targets, f"numbers of at most {_MAX_MAGNITUDE:g}")
        if guess is None and not isinstance(values, Grid):  # iterates from a guess may be anywhere
            for coordinate, column in zip(coordinates, np.moveaxis(targets, -1, 0), strict=True):
                self._require_unit(coordinate, column)
        shape = targets.shape[:-1]
        starts = None if guess is None else self._starts(guess, shape)
        if coordinates == self.command_coordinates:
            self.require_regular_drives(from_home=starts is None or bool((starts == self.home.q).all(axis=1).any()))
        rows = targets.reshape(math.prod(shape), len(coordinates))
        placing = self.placing_drives if coordinates == self.command_coordinates else list(range(len(coordinates)))
        independent = tuple(coordinates[k] for k in placing)
        continuation = self.continuation(independent) if engine == "program" else None
        keep = branches == "home"

        def find(which: Indices | slice) -> Solution:
            own = None if starts is None else starts[which]
            solver = self._finder(independent, engine)
            return find_poses(self, independent, rows[which][:, placing], own, solver, keep_branch=keep)

        is_shared = len(placing) < len(coordinates)
        if is_shared:
            shared = self._shared_commands(engine)
            found = Solution(shared.poses(lambda which: find(which).q, rows, starts, keep_branch=keep))
        elif continuation is not None and isinstance(values, Grid) and starts is None:
            found = continuation.march(values, threads, keep_branch=keep)
        else:
            found = find(slice(None))
        if on_failure == "raise" and np.isnan(found.q[:, :1]).any():  # nq may be 0
            failed = np.flatnonzero(np.isnan(found.q[:, 0]))
            index = "" if len(rows) == 1 else f" (the first of {failed.size} of {len(rows)} poses)"
            if is_shared and np.isfinite(off := shared.differences(find(failed[:1]).q, rows[failed[:1]])[0]).all():
                raise self._contradicting(rows[failed[0]], off, shared.worst(off), index)
            start = start_of(self) if starts is None else starts[failed[0]]
            raise self._unreachable(independent, rows[failed[0], placing], start, index)
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

    def _unreachable(
        self, coordinates: tuple[Coordinate, ...], target: Vector, start: Vector, which: str
    ) -> UnreachablePoseError:
        """Return the error for a pose that was not found, with the residual of damped steps from the start."""
        result = assemble_at(self, coordinates, target, start)
        pose = ", ".join(f"{c.name} = {v:.9g} {c.unit}" for c, v in zip(coordinates, target, strict=True))
        reason = f"residual {result.residual:.3e} m or rad"
        placed = {c.tool for c in coordinates if c.tool is not None}
        if not placed >= {"rx", "rz"} and any(
            c.tool == "ry" and np.cos(v) < 0.0 for c, v in zip(coordinates, target, strict=True)
        ):
            reason = "ry alone is told within -90 .. 90 deg only; a joint's angle as coordinate has no such bounds"
        elif result.converged and self.has_branches:
            reason = "the drives leave joints free, and none of the ways tried leads there; another guess may"
            is_given = coordinates != self.placing_commands or self.drives_place_it
            if is_given and branches_of(self.prototype).conditions:
                reason = self._reference(coordinates).obstacle(start, target)
        message = f"{self.name}: no assembled configuration found at {pose}{which}: {reason}"
        return UnreachablePoseError(message, result.residual, reason)

    def _shared_commands(self, engine: Engine) -> SharedCommands:
        """Return what finds poses at the commands of all drives."""
        if engine not in self._shared:
            determine = len(self.coordinates) == len(self.placing_drives)
            coordinates = self.coordinates if determine else self.placing_commands

            def read(q: Matrix) -> Matrix:
                return self.at(q).coordinates if determine else np.asarray(self.read(coordinates, q))

            self._shared[engine] = SharedCommands(self, self._finder(coordinates, engine), coordinates, read)
        return self._shared[engine]

    def agreeing(self, q: Matrix, commands: Matrix) -> Matrix:
        """Return q, NaN where not all commands are those given."""
        return self._shared_commands(self.engine).agreeing(q, commands)

    @cached_property
    def _shared(self) -> dict[Engine, SharedCommands]:
        return {}

    def _contradicting(self, commands: Vector, off: Vector, worst: int, which: str) -> UnreachablePoseError:
        coordinates, placing = self.command_coordinates, self.placing_drives
        name, unit = coordinates[worst].name, coordinates[worst].unit
        reason = (
            f"{', '.join(coordinates[k].name for k in placing)} alone determine the pose, with {name} at "
            f"{commands[worst] + off[worst]:.9g} {unit}, not {commands[worst]:.9g}"
        )
        return UnreachablePoseError(f"{self.name}: the commands contradict each other{which}: {reason}", None, reason)

    def reason_without_programs(self, *, compiled: bool = True) -> str | None:
        """Return why poses are solved by Pinocchio, one by one; None if they are solved by programs.

        Unless these must be `compiled`, usual ones are only recorded, as LLVM takes a tenth of a second to load.
        """
        if not compiled and self.model.nq and self._closes_fully and not self.has_null_motions(self.coordinates):
            from pm3dof_pin.kinematics.closing_programs import program_source
            from pm3dof_pin.programs.closing import Task

            try:
                program_source(self).require_walk(self, Task.from_coordinates(self.coordinates))
            except ProgramError as error:
                return str(error)
            return None
        solver = self._solver(self.coordinates)
        return solver if isinstance(solver, str) else None

    def continuation(self, coordinates: tuple[Coordinate, ...]) -> Continuation | None:
        """Return the solver for these coordinates by programs, or None if there is none and Pinocchio solves them."""
        solver = self._solver(coordinates)
        return None if isinstance(solver, str) else solver

    def _solver(self, coordinates: tuple[Coordinate, ...]) -> Continuation | str:
        """Return the solver for these coordinates by programs, or why there is none."""
        if self.model.nq == 0:
            return "it has no movable joints"
        if coordinates not in self._solvers:
            try:
                # a single pose by Pinocchio needs no compiler
                from pm3dof_pin.kinematics.continuation import Continuation

                solver = Continuation(self, coordinates)
                self._require_close_by(coordinates, solver)
                self._solvers[coordinates] = solver
            except ProgramError as error:
                _logger.info("%s: solved without programs: %s", self.name, error)
                self._solvers[coordinates] = str(error)
        return self._solvers[coordinates]

    @property
    def _closes_fully(self) -> bool:
        first = self.prototype if self.is_variant_of(self.prototype) else self  # whose loops close as fully
        return first.home.closure_residual <= self.rounding_of_closures

    def _require_close_by(self, coordinates: tuple[Coordinate, ...], solver: Continuation) -> None:
        """Raise ProgramError if programs of loops that do not close fully lose them near home."""
        if self._closes_fully:
            return
        sizes = [self.characteristic_length if coordinate.unit == "m" else 1.0 for coordinate in coordinates]
        steps = _CLOSE_BY * np.diag(sizes)
        found = find_poses(self, coordinates, solver.read(self.home.q[None]) + np.vstack([steps, -steps]), None, solver)
        if np.isnan(found.q).any():
            residual = self.home.closure_residual
            raise ProgramError(
                f"{self.name}: its closures contradict each other by {residual:.1e}, too much for programs"
            )

    def _finder(self, coordinates: tuple[Coordinate, ...], engine: Engine) -> Solver:
        """Return what finds poses at these coordinates."""
        return (self.continuation(coordinates) if engine == "program" else None) or self._reference(coordinates)

    def _reference(self, coordinates: tuple[Coordinate, ...]) -> Reference:
        return self._references.setdefault(coordinates, Reference(self, coordinates))

    @cached_property
    def _references(self) -> dict[tuple[Coordinate, ...], Reference]:
        return {}

    @cached_property
    def _solvers(self) -> dict[tuple[Coordinate, ...], Continuation | str]:
        return {}


load = Robot.load


def _require_placements(matrices: Array) -> None:
    rotation = matrices[..., :3, :3]
    defect = np.abs(np.swapaxes(rotation, -1, -2) @ rotation - np.eye(3)).max(initial=0.0)
    if not defect <= 1e-9 or (np.linalg.det(rotation) < 0.0).any() or (matrices[..., 3, :] != [0, 0, 0, 1]).any():
        raise InvalidValueError("placement", matrices, "a rotation matrix, a position and the last row 0 0 0 1")


def _driven_by(drives: Iterable[str], described: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of a mechanism with other actuated joints; those that stay so keep their commands."""
    model, names = described["model"], [drives] if isinstance(drives, str) else list(drives)
    known = list(model.names)[1:]
    for name in names:
        if name not in known:
            raise JointNotFoundError(name, "drives", known)
        if names.count(name) > 1:
            raise InvalidValueError("drives", names, "each joint once")
    commands = [command for command in described.get("commands", ()) if command.joint in names]
    return {"actuated_joints": names, "commands": commands}
