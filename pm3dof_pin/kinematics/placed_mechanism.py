"""A mechanism with a home and coordinates: what its solvers know of a robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import frozen
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS, Command, Coordinate, tool_coordinates
from pm3dof_pin.exceptions import ConvergenceError, InvalidValueError, SingularConfigurationError, first_words
from pm3dof_pin.kinematics.actuation import independent_drives, motion_components, motions_of_drives
from pm3dof_pin.kinematics.assembly import Assembly, assemble
from pm3dof_pin.kinematics.degrees_of_freedom import RankDecision, scaled_closures
from pm3dof_pin.kinematics.mobility import generic_configuration, instantaneous_mobility
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.mechanism.mechanism import Mechanism
from pm3dof_pin.mechanism.tool_components import tool_components
from pm3dof_pin.tolerances import IMPRECISE_AXES, IMPRECISION_MARGIN, MAX_IMPRECISION
from pm3dof_pin.typing import Array, Vector

_HOME = "home"
_NEARBY, _NEARBY_STARTS = 0.01, 4  # of an open home [rad, characteristic lengths]
_USUAL = 5  # poses near home at all of which drives are singular that are so everywhere
_SAME = 0.2  # largest distance of configurations that are one [rad, characteristic lengths]


class PlacedMechanism(Mechanism):
    """A mechanism with its home and coordinates; :class:`~pm3dof_pin.kinematics.robot.Robot` adds solvers to it."""

    @cached_property
    def described_home(self) -> Configuration:
        """The named configuration "home" or else all zeros, whose loops may be open.

        In an open tree, joints whose limits exclude zero are put in the middle of their range, or at its end.
        """
        named = self.named_configurations.get(_HOME)
        return self.configuration(self._zeros if named is None else named)

    @cached_property
    def closure_tolerance(self) -> float:
        """Largest closure error of closed loops [m, rad]; for variants that of their prototype.

        As declared; or else rounding, if the loops close to that at home; or else three times what the damped solver
        leaves with the drives at rest, if that is at most 1e-4 characteristic lengths or rad: the loops of a robot
        from CAD, with numbers of six or seven digits, close no better.
        """
        usual = super().closure_tolerance
        if self.prototype is not self:
            return self.prototype.closure_tolerance
        if self.declared_closure_tolerance is not None or not self.has_loops:
            return usual
        described = self.described_home
        if described.closure_residual <= usual:
            return usual
        drives = {name: described.joint_position(name) for name in self.actuated_joints}
        held = assemble(self, described, joints=drives, tolerance=usual)
        error = np.abs(held.configuration.closure_error / self.closure_scale).max(initial=0.0)
        imprecise = error <= MAX_IMPRECISION
        return IMPRECISION_MARGIN * held.residual if imprecise and not held.converged else usual

    @cached_property
    def rank_tolerance(self) -> float:
        """Relative singular value up to which a gap may lie; for variants that of their prototype.

        That of any mechanism; or more, if closures are redundant at home but for axes of six digits: what is so there
        is so everywhere, while elsewhere values as small may tell of a singular pose nearby.
        """
        usual = super().rank_tolerance
        if self.prototype is not self:
            return self.prototype.rank_tolerance
        if not self.has_loops or usual >= IMPRECISE_AXES or self.home.closure_residual > self.closure_tolerance:
            return usual
        values: Vector = np.asarray(np.linalg.svd(scaled_closures(self.home), compute_uv=False), dtype=np.float64)
        strict, loose = (RankDecision.by_gap(values, float(values[0]), ceiling) for ceiling in (usual, IMPRECISE_AXES))
        return IMPRECISE_AXES if loose.rank < strict.rank else usual

    @cached_property
    def home(self) -> Configuration:
        """The described home, with its loops closed if there is one way to do so nearby.

        The actuated joints keep their positions if the loops close that way. If no closed configuration is found, or
        different ones from starts a hundredth of a radian apart, it is the described one: check its
        :attr:`Configuration.closure_residual`.
        """
        described = self.described_home
        if described.closure_residual <= self.closure_tolerance:
            return described
        drives = {name: described.joint_position(name) for name in self.actuated_joints}
        for joints in (drives, {}):
            result = assemble(self, described, joints=joints)
            if result.converged and self._is_only_way(described, result, joints):
                return result.configuration
        return described

    def _is_only_way(self, described: Configuration, found: Assembly, joints: Mapping[str, float]) -> bool:
        """Return whether starts near the described home end near the configuration found from it."""
        if self.prototype is not self:  # as its prototype's, of which it is a small variation
            return self.prototype.home.closure_residual <= self.prototype.closure_tolerance
        generator = np.random.default_rng(0)
        for _ in range(_NEARBY_STARTS):
            motion = self.velocity_scale * generator.uniform(-_NEARBY, _NEARBY, self.model.nv)
            other = assemble(self, pin.integrate(self.model, described.q, motion), joints=joints)
            apart = pin.difference(self.model, found.q, other.q) / self.velocity_scale
            if not other.converged or np.abs(apart).max(initial=0.0) > _SAME:
                return False
        return True

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
    def coordinates(self) -> tuple[Coordinate, ...]:
        """The independent numbers that place the tool.

        In order of precedence: those declared by the description; the tool's placement if it has six degrees of
        freedom; if there are more drives than degrees of freedom, as many components of the tool's placement as it has
        degrees of freedom; the commands. A variant with the same tool frame has those of its prototype.
        """
        if self.declared_coordinates:
            return self.declared_coordinates
        first = self.prototype
        if first is not self and self.tool_frame == first.tool_frame and self.is_variant_of(first):
            return first.coordinates
        return self._tool_coordinates() or self.command_coordinates

    @cached_property
    def command_coordinates(self) -> tuple[Coordinate, ...]:
        """The commands, as coordinates."""
        return tuple(_as_coordinate(command) for command in self.commands)

    def configuration(self, q: ArrayLike) -> Configuration:
        """Return the read-only :class:`Configuration` at q, shape=(nq,) [m, rad]; its loops need not be closed."""
        return Configuration(self, q)

    def coordinate(self, name: str) -> Coordinate:
        """Return a coordinate by name; InvalidValueError if there is none of this name."""
        for coordinate in self.coordinates:
            if coordinate.name == name:
                return coordinate
        raise InvalidValueError("coordinate", name, f"one of {', '.join(c.name for c in self.coordinates)}")

    def range_of(self, coordinate: Coordinate | Command) -> tuple[float, float]:
        """Return the declared range of a coordinate or command, or its joint's; infinite if there is none [m, rad]."""
        if isinstance(coordinate, Command):
            coordinate = _as_coordinate(coordinate)
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

    def is_variant_of(self, other: PlacedMechanism) -> bool:
        """Whether another mechanism has the same closures, drives and coordinates."""
        names = ("closures", "couplings", "actuated_joints", "declared_coordinates")
        return all(getattr(self, name) == getattr(other, name) for name in names)

    @cached_property
    def arm_reach(self) -> tuple[Vector, float] | None:
        """Sphere that the tool of an open chain of hinges cannot leave, its centre and radius [m]; None for others."""
        if self.has_loops or self.tool_frame is None:
            return None
        model, tool = self.model, self.model.frames[self.tool_frame_id]
        chain = list(model.supports[tool.parentJoint])[1:]
        if not chain or not all(model.joints[index].shortname().startswith("JointModelR") for index in chain):
            return None
        first, *links = (model.jointPlacements[index].translation for index in chain)
        lengths = [float(np.linalg.norm(link)) for link in (*links, tool.placement.translation)]
        return frozen(np.array(first)), sum(lengths)

    @cached_property
    def placing_drives(self) -> list[int]:
        """The drives that place the mechanism: all of them, unless there are more than degrees of freedom."""
        first = self.prototype
        if first is not self and self.is_variant_of(first):
            return first.placing_drives
        if self.has_loops:
            try:
                if drives := independent_drives(self._usual):
                    return drives
            except (ConvergenceError, InvalidValueError):
                pass  # the loops do not close: the solvers report it
        return list(range(len(self.commands)))

    @property
    def placing_commands(self) -> tuple[Coordinate, ...]:
        """The commands of :attr:`placing_drives`, as coordinates."""
        return tuple(self.command_coordinates[k] for k in self.placing_drives)

    @property
    def drives_place_it(self) -> bool:
        """Whether usual poses follow from the drives, but for motions that leave the tool at rest as well.

        Raises:
            ConvergenceError: the loops do not close near home.
        """
        motions, told, _ = self._motions_of_drives
        return told == motions

    @property
    def drives_are_dependent(self) -> bool:
        """Whether the drives are enough to place the mechanism, and yet do not determine its pose anywhere around home.

        As those of a platform on legs whose ends are similar hexagons. Where the loops are open, solvers report that.
        """
        try:
            motions, told, _ = self._motions_of_drives
        except (ConvergenceError, InvalidValueError):
            return False
        return told < min(motions, len(self.commands))

    @property
    def branching_drives(self) -> list[int]:
        """Entries of v of the drives whose rates tell branches apart: none if they are dependent."""
        return [] if self.drives_are_dependent else super().branching_drives

    def require_regular_drives(self, *, from_home: bool = True) -> None:
        """Check that poses follow from the commands, unless there are too few drives. Solvers report open loops.

        Args:
            from_home: whether poses are reached from home.

        Raises:
            SingularConfigurationError: :attr:`drives_are_dependent`; or, if `from_home`, redundant ones do not
                determine the pose at home, so that commands next to it have several poses.
        """
        try:
            _, told, at_home = self._motions_of_drives
        except (ConvergenceError, InvalidValueError):
            return
        drives = f"{self.name}: the drives {first_words(self.actuated_joints)} do not determine the pose"
        if self.drives_are_dependent:
            raise SingularConfigurationError(
                f"{drives}, at home and all around it: with these at rest the tool can move, under any load. Place it "
                "by coordinates of the tool (`coordinates` of the closures file; pm3dof ik), or by other drives "
                "(--drives)"
            )
        if from_home and at_home < told:
            raise SingularConfigurationError(
                f"{drives} at home, a singular pose of theirs, near which several poses have the same commands: "
                "define a configuration 'home' beside it (pm3dof info --assemble), or give a guess"
            )

    @cached_property
    def _motions_of_drives(self) -> tuple[int, int, int]:
        """The motions at usual poses, how many of them the drives tell apart, and at home if drives are redundant.

        See :func:`motions_of_drives`. Of as many drives as motions, branches tell whether home is singular.
        """
        first, count = self.prototype, len(self.commands)
        if first is not self and self.tool_frame == first.tool_frame and self.is_variant_of(first):
            return first._motions_of_drives
        if not self.has_loops or self.tool_frame is None:
            return count, count, count
        motions = told = 0
        for seed in range(_USUAL):  # some may be near a singular pose by chance
            usual = self._usual if seed == 0 else generic_configuration(self.home, seed=seed)
            motions, told = max((motions, told), motions_of_drives(usual), key=lambda found: found[1])
            if told == min(motions, count):
                break
        return motions, told, motions_of_drives(self.home)[1] if told == motions < count else told

    @cached_property
    def _usual(self) -> Configuration:
        """A configuration near home that is regular with probability one; errors as :func:`generic_configuration`."""
        return generic_configuration(self.home)

    def has_null_motions(self, coordinates: Sequence[Coordinate]) -> bool:
        """Return whether the drives can move while coordinates of the tool stay, so that poses there are many.

        As of a serial arm, any of them serves then, if the loops are assembled alike.
        """
        return any(c.tool is not None for c in coordinates) and len(coordinates) < len(self.placing_drives)

    def _tool_coordinates(self) -> tuple[Coordinate, ...]:
        """Return components of the tool's placement that describe a pose better than the commands, if any."""
        if self.tool_frame is None:
            return ()
        try:
            mobility = instantaneous_mobility(self._usual)
            if mobility.tool_mobility == len(TOOL_COMPONENTS):
                return tool_coordinates(TOOL_COMPONENTS)
            if not mobility.tool_mobility == mobility.actuator_rank.rank < len(self.commands):
                return ()
            components = motion_components(self.home)
            at_home = len(components) == mobility.tool_mobility
            return tool_coordinates(components if at_home else motion_components(self._usual))
        except (ConvergenceError, InvalidValueError):
            return ()


def _as_coordinate(command: Command) -> Coordinate:
    return Coordinate(command.name, command.unit, joint=command.joint, offset=command.offset, scale=command.scale)
