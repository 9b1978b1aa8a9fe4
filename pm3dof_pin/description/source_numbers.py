"""The numbers of a robot's sources of error, `sources` of its error file. What a file leaves out has the default here.

None of the defaults is measured on any machine: they are what a careful builder may expect of one with preloaded ball
screws in a workshop, there to be replaced.
"""

# ruff: noqa: N815 - the keys of the file end in their units

from __future__ import annotations

from itertools import pairwise
from typing import Annotated

import msgspec

from pm3dof_pin.description.schema import Name, Positive

NotNegative = Annotated[float, msgspec.Meta(ge=0.0)]
Pair = tuple[float, float]


class _Numbers(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Numbers by name, each with a default; keys that are not known are refused."""


class Waviness(_Numbers, frozen=True):
    """Errors of sliding drives that wave along their travel; no constant parameter describes them."""

    pitch_m: NotNegative = 3e-6  #: standard deviation of the amplitude of each wave along the drive [m]
    straightness_m: NotNegative = 3e-6  #: the same for those across it, in two directions [m]
    lengths_m: tuple[Positive, ...] = (0.12, 0.05, 0.02)  #: wavelengths, one wave for each [m]


class BentMember(_Numbers, frozen=True):
    """A member that bends where one of its sides is warmer than the other."""

    depth_m: Positive  #: distance of the two sides [m]
    #: from its beginning to its end, axes of the body that it ends on [m]; by default from the joint before. For a
    #: telescope, at the length that is meant
    along_m: tuple[float, float, float] | None = None


class Thermal(_Numbers, frozen=True):
    """Growth with temperature."""

    #: the machine is anywhere between so much colder and so much warmer than when it was as described [K]
    rise_K: NotNegative = 8.0
    #: each screw besides is anywhere between so much colder and warmer than their mean [K]: a gradient across the
    #: machine
    between_drives_K: NotNegative = 2.0
    expansion_per_K: NotNegative = 11.5e-6  #: thermal expansion [1/K]; steel's by default
    #: temperature along each screw as multiples of its rise, at growing distances from its fixed bearing [m]: a
    #: gradient along the screw; the same everywhere by default
    profile: tuple[Pair, ...] = ((0.0, 1.0),)
    #: joints or frames whose distance from the joint before grows, with their share of the rise. By default the frames
    #: at which links end, the first of each loop closure, at one half
    members: dict[Name, float] | None = None
    #: one side of a member that bends is anywhere between so much colder and warmer than the other, in each of two
    #: directions across it [K]
    across_K: NotNegative = 0.5
    bending: dict[Name, BentMember] = {}  #: members that bend, by the joint or frame at which they end; none by default


class Load(_Numbers, frozen=True):
    """What the springs of the description give under."""

    #: force and moment on the tool at work, axes of the base [N, N m]
    wrench: tuple[float, float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    payload_kg: NotNegative = 0.0  #: mass at the tool point [kg]
    own_weight: bool = True  #: whether the bodies have their weight; the description is of the weightless machine


class Clearance(_Numbers, frozen=True):
    """Play of passive joints: how far those named move to either side, along each of their axes [m]."""

    at: tuple[Name, ...] = ()
    play_m: NotNegative = 0.0


class Drives(_Numbers, frozen=True):
    """What keeps a drive from where its counter says: lengths for those that slide, angles for those that turn."""

    #: lost motion when a drive turns round: it stands half of it to one side or the other [m]
    backlash_m: NotNegative = 2e-6
    backlash_rad: NotNegative = 2e-5  #: the same [rad]
    encoder_step_m: NotNegative = 1e-6  #: step of the encoder; the drive stands anywhere within it [m]
    encoder_step_rad: NotNegative = 1e-5  #: the same [rad]
    #: force of the drive over its following error; none for a servo that integrates it away
    servo_stiffness_N_per_m: Positive | None = None
    servo_stiffness_Nm_per_rad: Positive | None = None  #: the same [N m/rad]


class Drift(_Numbers, frozen=True):
    """What changes in the course of a job and is not known, so that no correction removes it; none by default."""

    hours: NotNegative = 8.0  #: from when the machine was last as described to the end of the job [h]
    warming_K_per_h: NotNegative = 0.0  #: the machine warms or cools, so fast at most [K/h]
    zeros_m_per_h: NotNegative = 0.0  #: the zero of each sliding drive moves to either side, so fast at most [m/h]
    zeros_rad_per_h: NotNegative = 0.0  #: that of each turning drive [rad/h]


class Spectrum(_Numbers, frozen=True):
    """A one-sided power spectral density [unit^2/Hz], constant between growing edges [Hz], zero beyond them."""

    edges_Hz: tuple[NotNegative, ...]
    levels: tuple[NotNegative, ...]

    def __post_init__(self) -> None:
        """Check the edges and their number; msgspec makes a ValueError an error of the file."""
        if len(self.edges_Hz) != len(self.levels) + 1 or any(b <= a for a, b in pairwise(self.edges_Hz)):
            raise ValueError("growing edges_Hz, one more than levels")


class VibrationNumbers(_Numbers, frozen=True):
    """Vibration at a standing pose, by what shakes."""

    #: of every natural mode, as part of the critical one
    damping: Annotated[float, msgspec.Meta(gt=0.0, lt=1.0)] = 0.02
    #: force on the tool along each axis of the base [N^2/Hz]; 1 N from 10 to 500 Hz by default
    tool: Spectrum | None = Spectrum(edges_Hz=(10.0, 500.0), levels=(1.0 / 490.0,))
    #: force of each drive along its travel [N^2/Hz], or its torque [(N m)^2/Hz]; 1 N or N m likewise
    motors: Spectrum | None = Spectrum(edges_Hz=(10.0, 500.0), levels=(1.0 / 490.0,))
    #: acceleration of the base that carries the machine's axes, along each axis of the base [(m/s^2)^2/Hz]; 0.01 m/s^2
    #: from 5 to 100 Hz by default, a quiet workshop's floor
    axes: Spectrum | None = Spectrum(edges_Hz=(5.0, 100.0), levels=(1e-4 / 95.0,))


class SourceNumbers(_Numbers, frozen=True):
    """The numbers of all sources of error of a robot, beside the tolerances of its geometry."""

    waviness: Waviness = Waviness()
    thermal: Thermal = Thermal()
    load: Load = Load()
    clearance: Clearance = Clearance()
    drives: Drives = Drives()
    vibration: VibrationNumbers = VibrationNumbers()
    drift: Drift = Drift()
