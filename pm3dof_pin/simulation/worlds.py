"""Simulated worlds for measurements: a machine with its errors, its surroundings and an instrument."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, get_args

import numpy as np

from pm3dof_pin.arrays import finite_array
from pm3dof_pin.errors.body_temperatures import rises_of
from pm3dof_pin.errors.elastic_deflection import ElasticDeflection
from pm3dof_pin.errors.error_parameters import GeometricErrors, beside_guideways
from pm3dof_pin.errors.sensitivity import closable
from pm3dof_pin.errors.thermal_growth import ThermalGrowth
from pm3dof_pin.errors.vibration import Vibration
from pm3dof_pin.errors.waviness import GuideWaviness
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.measuring.observation import observed, touching_commands, with_encoders
from pm3dof_pin.measuring.wrenches import WEIGHT_COLUMN, WRENCH_COLUMNS, is_wrench, wrenches_of
from pm3dof_pin.simulation.simulated_machine import Conditions, SimulatedMachine
from pm3dof_pin.typing import Array

WorldName = Literal["everything", "geometry"]
WORLDS: tuple[WorldName, ...] = get_args(WorldName)

_LINKS_SHARE = (
    0.5  # of the screws' temperature rise, at the links, over a cold base: a machine that does not just scale
)

TEMPERATURE = "temperature_screws_K"
"""Column of the screws' temperature rise."""

_WARMEST = 8.0
_VIBRATION = (2e-6, 1e-5)  # m, rad


@dataclass(frozen=True, eq=False)
class World:
    """A machine and its surroundings."""

    machine: SimulatedMachine  #: the machine
    #: greatest temperature rise of the screws since the machine was as described, from 0; measured [K]
    warmest: float = 0.0
    heaviest: float = 0.0  #: greatest weight hung on the tool point, from 0; likewise known [N]
    #: greatest wrench on the tool, each component between minus and plus this, likewise known, world axes, shape=(6,)
    #: [N, N m]
    strongest: tuple[float, ...] = (0.0,) * 6

    @classmethod
    def random(cls, name: WorldName, errors: GeometricErrors, generator: np.random.Generator) -> World:
        """Draw a world for the parameters to be identified, within their tolerances.

        "everything": all six errors of all joints and frames, waviness of drives, thermal growth of screws and links,
        weight of bodies (if the description has springs), and vibration. Waviness and growth only for machines whose
        drives are all linear. "geometry": only the listed parameters have errors.

        Raises:
            InvalidValueError: there is no such world.
        """
        if name not in WORLDS:
            raise InvalidValueError("world", name, f"one of {', '.join(WORLDS)}")
        if name == "geometry":
            return cls(SimulatedMachine.random(errors, generator, everything=False))
        machine = SimulatedMachine.random(errors, generator)
        assert machine.geometric is not None
        truth, robot = machine.geometric.errors, errors.robot
        position, angle = _VIBRATION
        machine = replace(machine, vibration=Vibration(np.diag(np.repeat([position, angle], 3) ** 2)))
        if robot.springs:
            machine = replace(machine, elastic=ElasticDeflection())
        if any(command.unit != "m" for command in robot.commands):
            return cls(machine)
        # a member whose growth alone would strain the loops does not grow, since its neighbours grow too
        lengths = {p.place for p in truth.parameters if p.motion == "translation"}
        links = {loop.frame_a: _LINKS_SHARE for loop in robot.closures if loop.frame_a in lengths}
        machine = replace(
            machine,
            waviness=_waves_that_close(robot, GuideWaviness.random(len(robot.actuated_joints), generator)),
            thermal=ThermalGrowth(errors.fixed_bearings, members=links),
        )
        return cls(machine, _WARMEST)

    def only(self, source: str) -> World:
        """Return the world with only one source of error, see :meth:`SimulatedMachine.only`."""
        alone = self.machine.only(source)
        if getattr(alone, source) is None:
            raise InvalidValueError("source", source, "one that this machine has")
        return World(
            alone,
            self.warmest if source == "thermal" else 0.0,
            self.heaviest if source == "elastic" else 0.0,
            self.strongest if source == "elastic" else (0.0,) * 6,
        )

    def loaded(self, heaviest: float, strongest: Sequence[float] = (0.0,) * 6, *, large: bool = False) -> World:
        """Return the world with weights up to `heaviest` [N] and wrenches up to `strongest` on the tool.

        With `large`, the machine is solved for equilibrium under them instead of deflected linearly.

        Raises:
            InvalidValueError: a number is negative or not finite, or the machine has no springs.
        """
        if not 0.0 <= heaviest < np.inf:
            raise InvalidValueError("heaviest", heaviest, "a non-negative weight")
        wrench = finite_array("strongest", strongest, (len(WRENCH_COLUMNS),))
        if np.any(wrench < 0.0):
            raise InvalidValueError("strongest", wrench.tolist(), "non-negative magnitudes")
        if (heaviest > 0.0 or wrench.any()) and self.machine.elastic is None:
            raise InvalidValueError("loads", (heaviest, *strongest), "0, since this machine has no springs to deflect")
        machine = self.machine
        if machine.elastic is not None:
            machine = replace(machine, elastic=replace(machine.elastic, large=large))
        return replace(self, machine=machine, heaviest=heaviest, strongest=tuple(wrench.tolist()))

    def conditions(self, count: int, generator: np.random.Generator) -> dict[str, Array]:
        """Draw temperatures and loads, by the name of their column, shape=(count,) each."""
        ranges = {TEMPERATURE: (0.0, self.warmest), WEIGHT_COLUMN: (0.0, self.heaviest)}
        ranges |= {name: (-most, most) for name, most in zip(WRENCH_COLUMNS, self.strongest, strict=True)}
        return {name: generator.uniform(least, most, count) for name, (least, most) in ranges.items() if most}

    def poses(self, commands: Array, conditions: Mapping[str, Array]) -> Array:
        """Return the true poses of the tool, shape=(n, 4, 4), at commands [m, rad] under :meth:`conditions`.

        Raises:
            ConvergenceError: the loops do not close at a command.
        """
        return self.machine.poses(commands, self._surroundings(commands, conditions))

    def measure(
        self,
        commands: Array,
        generator: np.random.Generator,
        instrument: Instrument | None = None,
        given: Mapping[str, Array] | None = None,
    ) -> Measurements:
        """Measure the machine at commands [m, rad], each at its own temperature and load, drawn or given by column.

        Raises:
            InvalidValueError: wrenches are given, but the machine has no springs.
            ConvergenceError: the loops do not close at a command.
        """
        if self.machine.elastic is None and any(map(is_wrench, given or ())):
            raise InvalidValueError("loads", ", ".join(given or ()), "none: this machine has no springs to deflect")
        conditions = self.conditions(len(commands), generator) | dict(given or {})
        surroundings, seen_by = self._surroundings(commands, conditions), instrument or Instrument()
        robot = self.machine.nominal
        if seen_by.stops:
            count = len(seen_by.locked) or seen_by.placed[0].kind.dimension
            early = generator.normal(scale=seen_by.position_sigma, size=(len(commands), count))
            machine = partial(self.machine.state, conditions=surroundings)
            commands = touching_commands(robot, commands, machine, seen_by, early)
        measurements = observed(commands, self.machine.measure(commands, generator, surroundings, seen_by), seen_by)
        if seen_by.encoders:
            _, q = self.machine.state(commands, surroundings)
            measurements = with_encoders(measurements, robot, q, seen_by)
        if seen_by.stops:
            # the number of a touch is that it touches, of a lock that it is locked
            touches = (replace(each, values=0.0 * each.values) for each in measurements.datums)
            held = np.tile(seen_by.locked, (len(commands), 1)) if seen_by.locked else None
            measurements = replace(measurements, datums=tuple(touches), readings=held)
        elif seen_by.targets or seen_by.encoders:
            measurements = measurements.with_noise(generator, 0 if seen_by.targets else measurements.tool_columns)
        rows = len(measurements) // max(1, len(commands))  # rows of each pose, one for each target
        return replace(measurements, conditions={name: np.repeat(v, rows) for name, v in conditions.items()})

    def _surroundings(self, commands: Array, conditions: Mapping[str, Array]) -> Conditions:
        surroundings = Conditions()
        if TEMPERATURE in conditions:
            rises = np.repeat(conditions[TEMPERATURE][:, None], commands.shape[1], axis=1)
            surroundings = replace(surroundings, temperature_rises=rises)
        if warm := rises_of(conditions):
            surroundings = replace(surroundings, body_rises=warm)
        return replace(surroundings, wrenches=wrenches_of(conditions, self.machine.nominal, len(commands)))


def _waves_that_close(robot: Robot, waves: GuideWaviness) -> GuideWaviness:
    """Return waves without those with which the loops cannot close, such as out of the plane of a planar robot."""
    if not robot.closures or not waves.straightness:
        return waves
    across = GeometricErrors(robot, beside_guideways(robot))
    closing = iter(np.isin(across.names, closable(across).names))
    kept = [[wave if next(closing) else () for wave in pair] for pair in waves.straightness]
    return replace(waves, straightness=tuple((first, second) for first, second in kept))
