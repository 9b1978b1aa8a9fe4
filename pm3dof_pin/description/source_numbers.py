"""Parameters of a robot's error sources: `sources` of its error file, with defaults.

No default is measured: they are what a careful builder may expect of a machine with preloaded ball screws in a
workshop, and are meant to be replaced.
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
    """Named numbers with defaults; unknown keys are refused."""


class Waviness(_Numbers, frozen=True):
    """Errors of sliding drives that vary periodically along their travel; no constant parameter describes them."""

    pitch_m: NotNegative = 3e-6  #: standard deviation of the amplitude of each wave along the drive [m]
    straightness_m: NotNegative = 3e-6  #: the same for waves across it, in two directions [m]
    lengths_m: tuple[Positive, ...] = (0.12, 0.05, 0.02)  #: wavelengths, one wave for each [m]


class BentMember(_Numbers, frozen=True):
    """A member that bends when one of its sides is warmer than the other."""

    depth_m: Positive  #: distance between the two sides [m]
    #: vector from its start to its end, in axes of the body at its end [m]; by default from the preceding joint. For
    #: a telescope, give the length to use
    along_m: tuple[float, float, float] | None = None


class Thermal(_Numbers, frozen=True):
    """Thermal expansion."""

    #: the machine is up to this much colder or warmer than at the reference state of the description [K]
    rise_K: NotNegative = 8.0
    #: each screw is in addition up to this much colder or warmer than their mean [K]: a gradient across the machine
    between_drives_K: NotNegative = 2.0
    expansion_per_K: NotNegative = 11.5e-6  #: coefficient of thermal expansion [1/K]; steel by default
    #: temperature along each screw as multiples of its rise, at increasing distances from its fixed bearing [m]: a
    #: gradient along the screw; uniform by default
    profile: tuple[Pair, ...] = ((0.0, 1.0),)
    #: joints or frames at the ends of growing members, with their share of the rise; or one number for all of them: 1
    #: for a uniformly warm machine, which scales
    members: dict[Name, float] | float = 1.0
    #: one side of a bending member is up to this much colder or warmer than the other, in each of two directions
    #: across it [K]
    across_K: NotNegative = 0.5
    bending: dict[Name, BentMember] = {}  #: bending members, by the joint or frame at their end; none by default
    #: links, screws, rods or groups (screws, drives, spindle) that are, each by itself, up to this much colder or
    #: warmer than the rest [K]; none by default
    bodies_K: dict[Name, NotNegative] = {}
    #: links in which the temperature varies along each axis, by up to this to either side [K/m]; none by default
    gradients_K_per_m: dict[Name, NotNegative] = {}
    #: expansion of links, screws, rods or groups of another material, by name [1/K]; none by default
    expansions_per_K: dict[Name, NotNegative] = {}


class Load(_Numbers, frozen=True):
    """Loads that deflect the springs of the description."""

    #: force and moment on the tool at work, axes of the base [N, N m]
    wrench: tuple[float, float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    payload_kg: NotNegative = 0.0  #: mass at the tool point [kg]
    own_weight: bool = True  #: whether the bodies have weight; the description is of the weightless machine


class Clearance(_Numbers, frozen=True):
    """Clearance of passive joints: how far the named joints can move to either side along each of their axes [m]."""

    at: tuple[Name, ...] = ()
    play_m: NotNegative = 0.0


class Drives(_Numbers, frozen=True):
    """What keeps a drive from its commanded position: lengths for sliding drives, angles for rotary ones."""

    #: lost motion on reversal: the drive is off by half of it to either side [m]
    backlash_m: NotNegative = 2e-6
    backlash_rad: NotNegative = 2e-5  #: the same [rad]
    encoder_step_m: NotNegative = 1e-6  #: encoder resolution; the drive may be anywhere within one step [m]
    encoder_step_rad: NotNegative = 1e-5  #: the same [rad]
    #: force of the drive per following error; none for a servo with integral action
    servo_stiffness_N_per_m: Positive | None = None
    servo_stiffness_Nm_per_rad: Positive | None = None  #: the same [N m/rad]


class Drift(_Numbers, frozen=True):
    """Unknown changes during a job, which no correction removes; none by default."""

    hours: NotNegative = 8.0  #: from the machine's last reference state to the end of the job [h]
    warming_K_per_h: NotNegative = 0.0  #: maximum rate of warming or cooling [K/h]
    zeros_m_per_h: NotNegative = 0.0  #: maximum drift of the zero of each sliding drive, either way [m/h]
    zeros_rad_per_h: NotNegative = 0.0  #: the same for each rotary drive [rad/h]


class Spectrum(_Numbers, frozen=True):
    """A one-sided power spectral density [unit^2/Hz], constant between increasing edges [Hz], zero beyond them."""

    edges_Hz: tuple[NotNegative, ...]
    levels: tuple[NotNegative, ...]

    def __post_init__(self) -> None:
        """Check the edges and their number; msgspec turns a ValueError into an error of the file."""
        if len(self.edges_Hz) != len(self.levels) + 1 or any(b <= a for a, b in pairwise(self.edges_Hz)):
            raise ValueError("increasing edges_Hz, one more than levels")


class VibrationNumbers(_Numbers, frozen=True):
    """Vibration at a fixed pose, by excitation."""

    #: of every natural mode, relative to critical damping
    damping: Annotated[float, msgspec.Meta(gt=0.0, lt=1.0)] = 0.02
    #: force on the tool along each axis of the base [N^2/Hz]; 1 N from 10 to 500 Hz by default
    tool: Spectrum | None = Spectrum(edges_Hz=(10.0, 500.0), levels=(1.0 / 490.0,))
    #: force of each drive along its travel [N^2/Hz], or its torque [(N m)^2/Hz]; likewise 1 N or N m
    motors: Spectrum | None = Spectrum(edges_Hz=(10.0, 500.0), levels=(1.0 / 490.0,))
    #: acceleration of the base along each of its axes [(m/s^2)^2/Hz]; 0.01 m/s^2
    #: from 5 to 100 Hz by default, a quiet workshop's floor
    axes: Spectrum | None = Spectrum(edges_Hz=(5.0, 100.0), levels=(1e-4 / 95.0,))


class SourceNumbers(_Numbers, frozen=True):
    """Parameters of all error sources of a robot, other than geometric tolerances."""

    waviness: Waviness = Waviness()
    thermal: Thermal = Thermal()
    load: Load = Load()
    clearance: Clearance = Clearance()
    drives: Drives = Drives()
    vibration: VibrationNumbers = VibrationNumbers()
    drift: Drift = Drift()
