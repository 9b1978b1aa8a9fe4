"""Machines with errors, written without the package: plain NumPy; nothing of :mod:`pm3dof_pin` moves them.

A tripod (sliders, links, a passive leg), six rods between a base and a platform (a linear delta, a hexapod, a 6-RUS
with cranks), a 3-RPS, a five-bar and a serial arm. Each has errors of its geometry and, optionally, effects that no
parameter describes: lead errors, waves of drives and guideways, sag, backlash, and drift during the measurement. Screws
may also grow with the temperature.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

LENGTH, ANGLE = 1e-4, 5e-4
"""Standard deviations of geometric errors [m, rad], those of the error files."""

_STEPS = 6
_CLOSED = 1e-13  # [m]
_STEP = 1e-6


@dataclass
class Effects:
    """Errors of the drives relative to their commands. All arrays in metres and radians.

    Attributes:
        lead: relative error of each counter.
        amplitudes: of its waves along the drive and across it, shape=(drives, 3, periods).
        phases: of these waves.
        periods: in units of the counter.
        backlash: change of a drive's position when it comes from the other side.
        drift: of each drive's zero over the session.
        sag: of the tool.
        expansion: of each drive's screw [1/K].
    """

    lead: np.ndarray
    amplitudes: np.ndarray
    phases: np.ndarray
    periods: np.ndarray
    backlash: np.ndarray
    drift: np.ndarray
    sag: float
    expansion: float = 0.0

    @classmethod
    def random(cls, generator: np.random.Generator, drives: int, unit: float, size: float) -> Effects:
        """Draw them.

        Args:
            generator: source of the random numbers.
            drives: number of drives.
            unit: a metre of drive in the counter's unit: 1, or 1 / radius for a drive that turns.
            size: 1 for a usual machine, 0 for none of this.
        """
        normal, periods = generator.standard_normal, unit * np.array([0.12, 0.05, 0.02])
        return cls(
            lead=size * 5e-5 * normal(drives),
            amplitudes=size * 4e-6 * unit * normal((drives, 3, 3)),
            phases=generator.uniform(0.0, 2 * np.pi, (drives, 3, 3)),
            periods=periods,
            backlash=size * 3e-6 * unit * normal(drives),
            drift=size * 6e-6 * unit * normal(drives),
            sag=size * 3e-5 * abs(float(normal())),
        )

    def drives(
        self, commands: np.ndarray, sides: np.ndarray, times: np.ndarray, rises: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return positions of the drives, shape=(n, drives), and offsets across their lines, shape=(n, drives, 2)."""
        scale = 1.0 + self.lead + self.expansion * rises[:, None]
        u = commands * scale + 0.5 * sides * self.backlash + times[:, None] * self.drift
        waves = np.sum(self.amplitudes * np.sin(2 * np.pi * u[:, :, None, None] / self.periods + self.phases), axis=3)
        return u + waves[:, :, 0], waves[:, :, 1:]


class Machine(ABC):
    """A machine with errors."""

    effects: Effects

    def poses(
        self,
        commands: np.ndarray,
        sides: np.ndarray | float = 0.0,
        times: np.ndarray | float = 0.0,
        rises: np.ndarray | float = 0.0,
    ) -> np.ndarray:
        """Return the tool's placements, shape=(n, 4, 4).

        Args:
            commands: shape=(n, drives).
            sides: from which each drive comes, -1 or 1, shape=(n, drives).
            times: from -1/2 to 1/2 over the session, shape=(n,).
            rises: of the screws' temperature [K], shape=(n,).
        """
        count = len(commands)
        u, beside = self.effects.drives(
            commands,
            np.broadcast_to(sides, commands.shape),
            np.broadcast_to(times, count),
            np.broadcast_to(rises, count),
        )
        return self._placed(u, beside)

    @abstractmethod
    def _placed(self, u: np.ndarray, beside: np.ndarray) -> np.ndarray: ...


def _solved(missed, start: np.ndarray) -> np.ndarray:  # type: ignore[no-untyped-def]
    """Solve equations by Newton's method, shape=(n, k)."""
    x = start
    for _ in range(_STEPS):
        off = missed(x)
        if np.abs(off).max() < _CLOSED:
            break
        slopes = np.stack([(missed(x + _STEP * row) - off) / _STEP for row in np.eye(x.shape[1])], axis=2)
        x = x - np.linalg.solve(slopes, off[..., None])[..., 0]
    return x


def _sagging(x: np.ndarray, sag: float) -> np.ndarray:
    """Return placements of platforms at x, y, z and rotation vectors, shape=(n, 6), that sag more beside the middle."""
    places = x[:, :3].copy()
    places[:, 2] -= sag * (1.0 + 0.3 * np.sum(x[:, :2] ** 2, axis=1) / 0.1**2)
    return _placement(Rotation.from_rotvec(x[:, 3:]).as_matrix(), places)


def _placement(rotations: np.ndarray, positions: np.ndarray) -> np.ndarray:
    tool = np.tile(np.eye(4), (len(positions), 1, 1))
    tool[:, :3, :3], tool[:, :3, 3] = rotations, positions
    return tool


def _around(radius: float, degrees: list[float], height: float) -> np.ndarray:
    angles = np.radians(degrees)
    return np.stack([radius * np.cos(angles), radius * np.sin(angles), height + 0.0 * angles], axis=1)


@dataclass
class Tripod(Machine):
    """Three sliders on guideways, three links, and a passive leg: a slider with a universal joint."""

    effects: Effects
    bases: np.ndarray
    guides: np.ndarray
    sides: np.ndarray
    lengths: np.ndarray
    joints: np.ndarray
    leg_turn: np.ndarray
    leg_shift: np.ndarray
    second_axis: np.ndarray
    second_shift: float
    tool_turn: np.ndarray
    tool_shift: np.ndarray

    @classmethod
    def random(cls, generator: np.random.Generator, size: float, richness: float) -> Tripod:
        """Draw a machine; `size` in units of the tolerances, `richness` of the effects that no parameter describes."""
        d, a, normal = size * LENGTH, size * ANGLE, generator.standard_normal
        bases = _around(0.37425, [-30.0, 90.0, -150.0], 0.0) + d * normal((3, 3))
        guides = _around(-np.cos(np.radians(50.0)), [-30.0, 90.0, -150.0], np.sin(np.radians(50.0)))
        guides = np.array([Rotation.from_rotvec(a * normal(3)).apply(guide) for guide in guides])
        across = np.array([np.cross(guide, [0.0, 0.0, 1.0]) for guide in guides])
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        return cls(
            effects=Effects.random(generator, 3, 1.0, richness),
            bases=bases,
            guides=guides,
            sides=np.stack([across, np.cross(guides, across)], axis=1),
            lengths=0.353 + d * normal(3),
            joints=_around(0.075, [-30.0, 90.0, -150.0], 0.013) + d * normal((3, 3)),
            leg_turn=a * normal(3),
            leg_shift=d * normal(3) * [1.0, 1.0, 0.0],
            second_axis=a * normal(3),
            second_shift=d * float(normal()),
            tool_turn=a * normal(3),
            tool_shift=d * normal(3),
        )

    def _placed(self, u: np.ndarray, beside: np.ndarray) -> np.ndarray:
        sliders = self.bases + u[..., None] * self.guides + np.einsum("nks,ksj->nkj", beside, self.sides)

        def missed(x: np.ndarray) -> np.ndarray:
            place, turn = self._platform(x)
            ends = place[:, None, :] + np.einsum("nij,kj->nki", turn, self.joints)
            return np.asarray(np.linalg.norm(ends - sliders, axis=2) - self.lengths)

        self.tilts = _solved(missed, np.tile([0.0, 0.0, 0.49], (len(u), 1)))
        place, turn = self._platform(self.tilts)
        return _placement(
            turn @ Rotation.from_rotvec(self.tool_turn).as_matrix(),
            place + np.einsum("nij,j->ni", turn, self.tool_shift),
        )

    def _platform(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        leg, zero, sag = Rotation.from_rotvec(self.leg_turn), 0.0 * x[:, 0], self.effects.sag
        place = (
            self.leg_shift + np.array([0.0, 0.0, 0.379]) + leg.apply(np.stack([zero, zero, x[:, 2] - 0.379], axis=1))
        )
        place[:, 2] -= sag * (1.0 + 5.0 * (x[:, 2] - 0.49)) + 0.5 * sag * np.sum(x[:, :2] ** 2, axis=1)
        first = leg * Rotation.from_rotvec(np.stack([x[:, 0], zero, zero], axis=1))
        first = first * Rotation.from_rotvec(self.second_axis)
        turn = first * Rotation.from_rotvec(np.stack([zero, x[:, 1], zero], axis=1))
        return place + first.apply([0.0, 0.0, self.second_shift]), turn.as_matrix()


@dataclass
class Rods(Machine):
    """Six rods between points that drives move and points of a platform; drives may also change their lengths."""

    effects: Effects
    anchors: np.ndarray
    guides: np.ndarray
    sides: np.ndarray
    drives: list[int]
    lengths: np.ndarray
    stretch: float
    joints: np.ndarray
    start: np.ndarray
    arms: np.ndarray | None = None  #: of cranks that turn about the guides, shape=(6, 3)
    tool: np.ndarray = field(default_factory=lambda: np.eye(4))

    @classmethod
    def delta(cls, generator: np.random.Generator, size: float, richness: float) -> Rods:
        """Draw a linear delta."""
        d, a, normal = size * LENGTH, size * ANGLE, generator.standard_normal
        towers = [210.0, 330.0, 90.0]
        across = np.cross([0.0, 0.0, 1.0], _around(1.0, towers, 0.0))
        anchors = np.repeat(_around(0.16, towers, 0.0) + 3.0 * d * normal((3, 3)), 2, axis=0)
        points = np.repeat(_around(0.03, towers, 0.04), 2, axis=0)
        apart = np.repeat(0.0225 * across, 2, axis=0) * np.array([1.0, -1.0] * 3)[:, None]
        lean = np.array([Rotation.from_rotvec(2.0 * a * normal(3)).apply([0.0, 0.0, 1.0]) for _ in towers])
        return cls(
            Effects.random(generator, 3, 1.0, richness),
            anchors + apart + d * normal((6, 3)),
            np.repeat(lean, 2, axis=0),
            np.repeat(np.stack([_around(1.0, towers, 0.0), across], axis=1), 2, axis=0),
            [0, 0, 1, 1, 2, 2],
            0.27 + d * normal(6),
            0.0,
            points + apart + d * normal((6, 3)),
            np.array([0.0, 0.0, 0.15]),
        )

    @classmethod
    def hexapod(cls, generator: np.random.Generator, size: float, richness: float) -> Rods:
        """Draw a hexapod whose struts change their lengths."""
        d, normal = size * LENGTH, generator.standard_normal
        anchors = _around(0.115, [-10.0, 10.0, 110.0, 130.0, 230.0, 250.0], 0.015)
        points = _around(0.09, [-50.0, 50.0, 70.0, 170.0, 190.0, -70.0], -0.06)
        lengths = np.linalg.norm(points + np.array([0.0, 0.0, 0.135]) - anchors, axis=1)
        return cls(
            Effects.random(generator, 6, 1.0, richness),
            anchors + d * normal((6, 3)),
            np.zeros((6, 3)),
            np.tile(np.eye(3)[:2], (6, 1, 1)),
            list(range(6)),
            lengths + d * normal(6),
            1.0,
            points + d * normal((6, 3)),
            np.array([0.0, 0.0, 0.135]),
        )

    @classmethod
    def cranks(cls, generator: np.random.Generator, size: float, richness: float) -> Rods:
        """Draw a 6-RUS: the machine of small_robots.py, whose bolts and bearings each have errors of their own."""
        d, a, normal = size * LENGTH, size * ANGLE, generator.standard_normal
        anchors = _around(0.35, [-15.0, 15.0, 105.0, 135.0, 225.0, 255.0], 0.0)
        points = _around(0.15, [-45.0, 45.0, 75.0, 165.0, 195.0, 285.0], -0.45)
        outward = anchors / np.linalg.norm(anchors, axis=1, keepdims=True)
        arms = 0.15 * (outward - [0.0, 0.0, 0.5]) / np.linalg.norm([1.0, 0.5])
        axes = np.cross([0.0, 0.0, 1.0], outward)
        lengths = np.linalg.norm(points - anchors - arms, axis=1)
        turns = [Rotation.from_rotvec(a * normal(3)) for _ in range(6)]
        tool = np.eye(4)
        tool[:3, :3], tool[:3, 3] = Rotation.from_rotvec(a * normal(3)).as_matrix(), d * normal(3)
        return cls(
            Effects.random(generator, 6, 1.0 / 0.15, richness),
            anchors + d * normal((6, 3)),
            np.array([turn.apply(axis) for turn, axis in zip(turns, axes, strict=True)]),
            np.tile(np.eye(3)[:2], (6, 1, 1)),
            list(range(6)),
            lengths + d * normal(6),
            0.0,
            points + [0.0, 0.0, 0.5] + d * normal((6, 3)),
            np.array([0.0, 0.0, -0.5]),
            np.array([turn.apply(arm) for turn, arm in zip(turns, arms, strict=True)]) + d * normal((6, 3)),
            tool,
        )

    def _placed(self, u: np.ndarray, beside: np.ndarray) -> np.ndarray:
        own, off = u[:, self.drives], beside[:, self.drives]
        ends = self.anchors + own[..., None] * self.guides
        if self.arms is None:
            ends = ends + np.einsum("nks,ksj->nkj", off, self.sides)
        else:
            turns = [Rotation.from_rotvec(own[:, k, None] * axis) for k, axis in enumerate(self.guides)]
            arms = [turn.apply(arm) for turn, arm in zip(turns, self.arms, strict=True)]
            ends = self.anchors + np.stack(arms, axis=1)

        def missed(x: np.ndarray) -> np.ndarray:
            turn = Rotation.from_rotvec(x[:, 3:]).as_matrix()
            rods = x[:, None, :3] + np.einsum("nij,kj->nki", turn, self.joints) - ends
            return np.asarray(np.linalg.norm(rods, axis=2) - self.lengths - self.stretch * own)

        height = np.mean(u, axis=1) * np.mean(self.guides[:, 2]) - np.sqrt(0.27**2 - 0.13**2) - 0.04
        start = np.tile(np.concatenate([self.start, np.zeros(3)]), (len(u), 1))
        if not self.stretch and self.arms is None:
            start[:, 2] = height
        x = _solved(missed, start)
        return _sagging(x, self.effects.sag) @ self.tool


@dataclass
class Hinged(Machine):
    """A 3-RPS: three legs that each turn about a hinge and change their length, balls on a platform."""

    effects: Effects
    across: np.ndarray
    zeros: np.ndarray
    leans: np.ndarray
    joints: np.ndarray

    @classmethod
    def random(cls, generator: np.random.Generator, size: float, richness: float) -> Hinged:
        """Draw the machine that comes with the package."""
        d, a, normal = size * LENGTH, size * ANGLE, generator.standard_normal
        return cls(
            Effects.random(generator, 3, 1.0, richness),
            d * normal(3),
            d * normal(3),
            a * normal(3),
            _around(0.18, [0.0, 120.0, -120.0], -0.12) + d * normal((3, 3)),
        )

    def _placed(self, u: np.ndarray, beside: np.ndarray) -> np.ndarray:
        turns = Rotation.from_euler("z", [[0.0], [120.0], [-120.0]], degrees=True).as_matrix()
        rod = np.hypot(0.17, 0.54) - 0.25 + u
        side = self.across - np.sin(self.leans) * rod + beside[..., 0]
        length = np.hypot(0.25 + self.zeros + np.cos(self.leans) * rod, beside[..., 1])

        def missed(x: np.ndarray) -> np.ndarray:
            turn = Rotation.from_rotvec(x[:, 3:]).as_matrix()
            ends = x[:, None, :3] + np.einsum("nij,kj->nki", turn, self.joints)
            own = np.einsum("kji,nkj->nki", turns, ends) - [0.35, 0.0, 0.08]
            return np.concatenate([own[..., 1] - side, np.hypot(own[..., 0], own[..., 2]) - length], axis=1)

        x = _solved(missed, np.tile([0.0, 0.0, 0.74, 0.0, 0.0, 0.0], (len(u), 1)))
        return _sagging(x, self.effects.sag)


@dataclass
class FiveBar(Machine):
    """A planar five-bar: two cranks, two forearms, the pen where they meet."""

    effects: Effects
    motors: np.ndarray
    zeros: np.ndarray
    cranks: np.ndarray
    forearms: np.ndarray
    tool: np.ndarray

    @classmethod
    def random(cls, generator: np.random.Generator, size: float, richness: float) -> FiveBar:
        """Draw the machine of the tests."""
        d, a, normal = size * LENGTH, size * ANGLE, generator.standard_normal
        tool = np.eye(4)
        tool[:3, :3], tool[:3, 3] = Rotation.from_rotvec(a * normal(3)).as_matrix(), d * normal(3)
        return cls(
            Effects.random(generator, 2, 4.0, richness),
            np.array([[-0.1, 0.0], [0.1, 0.0]]) + d * normal((2, 2)),
            np.array([2.2823075170803215, 0.8592851365094715]) + a * normal(2),
            0.25 + d * normal(2),
            0.35 + d * normal(2),
            tool,
        )

    def _placed(self, u: np.ndarray, beside: np.ndarray) -> np.ndarray:
        angles = self.zeros + u
        elbows = self.motors + self.cranks[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=2)
        apart = elbows[:, 1] - elbows[:, 0]
        square = np.sum(apart**2, axis=1)
        along = 0.5 + (self.forearms[0] ** 2 - self.forearms[1] ** 2) / (2.0 * square)
        up = np.sqrt(self.forearms[0] ** 2 / square - along**2)
        fore = along[:, None] * apart + up[:, None] * np.stack([-apart[:, 1], apart[:, 0]], axis=1)
        turn = Rotation.from_euler("z", np.arctan2(fore[:, 1], fore[:, 0])[:, None]).as_matrix()
        sag = -self.effects.sag * np.ones(len(u))
        return _placement(turn, np.column_stack([elbows[:, 0] + fore, sag])) @ self.tool


@dataclass
class Arm(Machine):
    """A serial arm of revolute joints, with the placements of a UR5.

    Attributes:
        effects: as above.
        placements: of each joint on the link before it, then of the tool, shape=(joints + 1, 4, 4).
        axes: of the joints, shape=(joints, 3).
    """

    effects: Effects
    placements: np.ndarray
    axes: np.ndarray

    @classmethod
    def random(
        cls, generator: np.random.Generator, size: float, richness: float, placements: np.ndarray, axes: np.ndarray
    ) -> Arm:
        """Draw an arm."""
        off = np.tile(np.eye(4), (len(placements), 1, 1))
        off[:, :3, :3] = Rotation.from_rotvec(size * ANGLE * generator.standard_normal((len(off), 3))).as_matrix()
        off[:, :3, 3] = size * LENGTH * generator.standard_normal((len(off), 3))
        effects = Effects.random(generator, len(axes), 10.0, richness)
        effects.lead *= 0.1
        effects.periods = np.array([2 * np.pi, np.pi, 2 * np.pi / 5])
        return cls(effects, placements @ off, axes)

    def _placed(self, u: np.ndarray, beside: np.ndarray) -> np.ndarray:
        place = np.tile(np.eye(4), (len(u), 1, 1))
        for k, axis in enumerate(self.axes):
            turn = _placement(Rotation.from_rotvec(u[:, k, None] * axis).as_matrix(), 0.0 * u[:, :3])
            place = place @ self.placements[k] @ turn
        place = place @ self.placements[-1]
        reach = place[:, :3, 3] - [0.0, 0.0, 0.1]
        place[:, 2, 3] -= 2.0 * self.effects.sag * np.sum(reach**2, axis=1)
        return place
