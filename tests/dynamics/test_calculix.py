"""Beams against CalculiX (`ccx`): stiffness, natural frequencies and receptances of bars with a load at their tip."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.dynamics.damping import Damping
from pm3dof_pin.dynamics.receptance import VibratingSystem, vibrating_system
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.springs import CantileverSpring
from pm3dof_pin.kinematics.robot import Robot

YOUNG, POISSON, DENSITY, RATIO = 2.09e11, 0.29, 7850.0, 0.02
SHEAR = YOUNG / (2.0 * (1.0 + POISSON))
MODES = 6
ELEMENTS = 6

pytestmark = pytest.mark.skipif(shutil.which("ccx") is None, reason="needs CalculiX (Debian package calculix-ccx)")


@dataclass(frozen=True)
class Bar:
    """A steel bar, clamped at one end and with a mass at the other."""

    length: float
    width: float
    tip: float
    is_round: bool

    @property
    def area(self) -> float:
        return self.width**2 * (np.pi / 4.0 if self.is_round else 1.0)

    @property
    def spring_constants(self) -> dict[str, float]:
        """E I, G J, E A and k G A, with the shear coefficients of G. Cowper (1966)."""
        moment = self.width**4 * (np.pi / 64.0 if self.is_round else 1.0 / 12.0)
        torsion = 2.0 * moment if self.is_round else 0.1406 * self.width**4
        numbers = (6.0, 7.0, 6.0) if self.is_round else (10.0, 12.0, 11.0)
        coefficient = numbers[0] * (1.0 + POISSON) / (numbers[1] + numbers[2] * POISSON)
        return {
            "bending_stiffness": YOUNG * moment,
            "torsional_stiffness": SHEAR * torsion,
            "axial_stiffness": YOUNG * self.area,
            "shear_stiffness": coefficient * SHEAR * self.area,
        }

    def system(self, elements: int, *, shear: bool = True) -> VibratingSystem:
        """The bar on a locked slide, with the mass at a locked joint at its tip."""
        model = pin.Model()
        model.name = "bar"
        clamp = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "clamp")
        up = pin.SE3(np.eye(3), np.array([0.0, 0.0, self.length]))
        tip = model.addJoint(clamp, pin.JointModelRZ(), up, "tip_joint")
        mass, middle = DENSITY * self.area * self.length, np.array([0.0, 0.0, 0.5 * self.length])
        model.appendBodyToJoint(clamp, pin.Inertia(mass, middle, np.eye(3)), pin.SE3.Identity())
        model.appendBodyToJoint(tip, pin.Inertia(self.tip, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
        model.addFrame(pin.Frame("tip", tip, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
        robot = Robot(model, [], actuated_joints=["clamp", "tip_joint"], tool_frame="tip")
        constants = self.spring_constants | ({} if shear else {"shear_stiffness": None})
        spring = CantileverSpring(
            "bar", "tip_joint", (0.0, 0.0, 1.0), length=self.length, elements=elements, mass=mass, **constants
        )
        return vibrating_system(ElasticModel(robot, [spring]), np.zeros(2), damping=Damping(ratio=RATIO))


def leg(length: float) -> Bar:
    """A bar like the tripod's passive leg, as thick, with the platform's mass."""
    return Bar(length, 0.015, 0.38, is_round=False)


def strut(length: float) -> Bar:
    """The hexapod's rod beyond its cylinder, with a sixth of the platform's mass."""
    return Bar(length, 0.0076, 1.0 / 6.0, is_round=True)


def beam_elements(bar: Bar, count: int = 10) -> tuple[list[str], str]:
    """Elements B32, which CalculiX expands to solids; return lines and the node at the tip."""
    nodes = [f"{k + 1},0,0,{bar.length * k / (2 * count)!r}" for k in range(2 * count + 1)]
    beams = [f"{k + 1},{2 * k + 1},{2 * k + 2},{2 * k + 3}" for k in range(count)]
    tip = str(2 * count + 1)
    section = ["*BEAM SECTION,ELSET=BAR,MATERIAL=STEEL,SECTION=RECT", f"{bar.width},{bar.width}", "1,0,0"]
    clamp = ["*BOUNDARY", "1,1,6"]
    return ["*NODE,NSET=ALL", *nodes, "*ELEMENT,TYPE=B32,ELSET=BAR", *beams, *section, *clamp], tip


def solid_elements(bar: Bar, across: int = 3, along: int = 8) -> tuple[list[str], str]:
    """Elements C3D20R, of which a round bar has a square grid pressed into the circle; its end is kept rigid."""
    numbers: dict[tuple[int, int, int], int] = {}
    for i, j, k in product(range(2 * across + 1), range(2 * across + 1), range(2 * along + 1)):
        if (i % 2) + (j % 2) + (k % 2) < 2:
            numbers[i, j, k] = len(numbers) + 1
    nodes = []
    for (i, j, k), number in numbers.items():
        u, v = i / across - 1.0, j / across - 1.0
        if bar.is_round:
            u, v = u * np.sqrt(1.0 - 0.5 * v * v), v * np.sqrt(1.0 - 0.5 * u * u)
        place = 0.5 * bar.width * u, 0.5 * bar.width * v, bar.length * k / (2 * along)
        nodes.append(",".join([str(number), *(f"{float(x):.12g}" for x in place)]))
    ring = [(0, 0), (2, 0), (2, 2), (0, 2)]
    sides = [(1, 0), (2, 1), (1, 2), (0, 1)]
    order = [(*at, z) for z in (0, 2) for at in ring] + [(*at, z) for z in (0, 2) for at in sides]
    order += [(*at, 1) for at in ring]
    elements = []
    for index, (i, j, k) in enumerate(product(range(across), range(across), range(along)), start=1):
        own = [str(numbers[2 * i + x, 2 * j + y, 2 * k + z]) for x, y, z in order]
        elements += [",".join([str(index), *own[:15]]) + ",", ",".join(own[15:])]
    ends = {z: [str(number) for place, number in numbers.items() if place[2] == z] for z in (0, 2 * along)}
    tip, turn = len(numbers) + 1, len(numbers) + 2
    nodes += [f"{n},0,0,{bar.length!r}" for n in (tip, turn)]
    return [
        *("*NODE,NSET=ALL", *nodes, "*ELEMENT,TYPE=C3D20R,ELSET=BAR", *elements),
        *("*SOLID SECTION,ELSET=BAR,MATERIAL=STEEL", "*NSET,NSET=CLAMP", *(f"{n}," for n in ends[0])),
        *("*NSET,NSET=END", *(f"{n}," for n in ends[2 * along]), "*BOUNDARY", "CLAMP,1,3"),
        f"*RIGID BODY,NSET=END,REF NODE={tip},ROT NODE={turn}",
    ], str(tip)


def calculix(
    folder: Path, bar: Bar, mesh: tuple[list[str], str], frequencies: list[float]
) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the deflection per lateral force at the tip [m/N], six natural frequencies [Hz], and receptances there."""
    lines, tip = mesh
    sweep = [
        f"*STEP\n*STEADY STATE DYNAMICS\n{f!r},{f!r},2\n*MODAL DAMPING\n1,12,{RATIO}\n*CLOAD\n{tip},1,1.\n"
        f"*NODE PRINT,NSET=TIP\nU\n*END STEP"
        for f in frequencies
    ]
    (folder / "bar.inp").write_text(
        "\n".join(
            [
                *("*MATERIAL,NAME=STEEL", "*ELASTIC", f"{YOUNG!r},{POISSON}", "*DENSITY", repr(DENSITY)),
                *(*lines, "*NSET,NSET=TIP", tip, "*ELEMENT,TYPE=MASS,ELSET=LOAD", f"100000,{tip}"),
                *("*MASS,ELSET=LOAD", repr(bar.tip)),
                *("*STEP", "*STATIC", "*CLOAD", f"{tip},1,1.", "*NODE PRINT,NSET=TIP", "U", "*END STEP"),
                *("*STEP", "*FREQUENCY,STORAGE=YES", "12", "*END STEP", *sweep),
            ]
        )
    )
    subprocess.run(["ccx", "bar"], cwd=folder, check=True, capture_output=True, timeout=120)
    rows = [re.findall(r"[-+]?\d+(?:\.\d+E[-+]\d+)?", line) for line in (folder / "bar.dat").read_text().splitlines()]
    moved = [float(row[1]) for row in rows if len(row) == 4 and row[0] == tip]
    natural = [float(row[3]) for row in rows if len(row) == 5 and row[0].isdigit()]
    swept = moved[-2 * len(frequencies) :]  # real and imaginary parts, after the static step and the modes' shapes
    return moved[0], np.array(natural[:MODES]), np.array(swept[::2]) + 1j * np.array(swept[1::2])


@pytest.mark.parametrize(("length", "allowed"), [(0.03, 0.08), (0.06, 0.02), (0.114, 0.02)])
def test_a_leg_bends_and_vibrates_as_beam_elements(tmp_path: Path, length: float, allowed: float) -> None:
    """From twice to eight times as long as thick. A square's torsion, and a mass at one node, are theirs alone."""
    bar = leg(length)
    frequencies = frequencies_near(bar)
    deflection, natural, swept = calculix(tmp_path, bar, beam_elements(bar), frequencies)
    for elements in (1, ELEMENTS):
        assert_alike(bar.system(elements), deflection, natural[:2], frequencies, swept, allowed)
    slender = bar.system(1, shear=False)
    tip = slender.rows(["tool:x"])
    assert length > 0.03 or slender.receptance([0.0], tip, tip).item().real < 0.85 * deflection


@pytest.mark.parametrize(
    ("bar", "allowed"),
    [
        *((leg(length), allowed) for length, allowed in ((0.03, 0.04), (0.06, 0.025), (0.114, 0.02))),
        *((strut(length), 0.025) for length in (0.0254, 0.0374, 0.0494)),  # at both ends of its stroke and at home
    ],
)
def test_six_modes_are_those_of_solids(tmp_path: Path, bar: Bar, allowed: float) -> None:
    """Solids know shear, rotary inertia and the bar's mass. With one element, only the first mode in each plane."""
    frequencies = frequencies_near(bar)
    deflection, natural, swept = calculix(tmp_path, bar, solid_elements(bar), frequencies)
    assert_alike(bar.system(1), deflection, natural[:2], frequencies, swept, allowed)
    assert_alike(bar.system(ELEMENTS), deflection, natural, frequencies, swept, allowed)


def frequencies_near(bar: Bar) -> list[float]:
    """Below and above the first mode."""
    return [part * float(bar.system(1).frequencies[0]) for part in (0.3, 0.8, 1.4)]


def assert_alike(
    system: VibratingSystem,
    deflection: float,
    natural: np.ndarray,
    frequencies: list[float],
    swept: np.ndarray,
    allowed: float,
) -> None:
    tip = system.rows(["tool:x"])
    assert system.receptance([0.0], tip, tip).item().real == pytest.approx(deflection, rel=allowed)
    assert system.frequencies[: len(natural)] == pytest.approx(natural, rel=allowed)
    found = system.receptance(frequencies, tip, tip)[:, 0, 0]
    np.testing.assert_allclose(found, swept, rtol=3.0 * allowed)  # near the mode, as its frequency differs
