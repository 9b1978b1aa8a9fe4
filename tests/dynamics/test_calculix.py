"""Beams against CalculiX (`ccx`): stiffness, natural frequencies and receptances of a leg with a load at its tip."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.dynamics.damping import Damping
from pm3dof_pin.dynamics.receptance import VibratingSystem, vibrating_system
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.springs import CantileverSpring
from pm3dof_pin.kinematics.robot import Robot

YOUNG, POISSON, DENSITY, SIDE, PLATFORM = 2.09e11, 0.29, 7850.0, 0.015, 0.38
SHEAR = YOUNG / (2.0 * (1.0 + POISSON))
AREA, INERTIA = SIDE**2, SIDE**4 / 12.0
COWPER = 10.0 * (1.0 + POISSON) / (12.0 + 11.0 * POISSON)  # shear coefficient of a rectangle, G. Cowper 1966
RATIO = 0.02

pytestmark = pytest.mark.skipif(shutil.which("ccx") is None, reason="needs CalculiX (Debian package calculix-ccx)")


def _leg(length: float, elements: int, *, shear: bool = True) -> VibratingSystem:
    """A square bar on a locked slide, with the mass of the platform at a locked joint at its tip."""
    model = pin.Model()
    model.name = "leg"
    clamp = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "clamp")
    up = pin.SE3(np.eye(3), np.array([0.0, 0.0, length]))
    tip = model.addJoint(clamp, pin.JointModelRZ(), up, "tip_joint")
    bar = DENSITY * AREA * length
    model.appendBodyToJoint(clamp, pin.Inertia(bar, np.array([0.0, 0.0, 0.5 * length]), np.eye(3)), pin.SE3.Identity())
    model.appendBodyToJoint(tip, pin.Inertia(PLATFORM, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", tip, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    robot = Robot(model, [], actuated_joints=["clamp", "tip_joint"], tool_frame="tip")
    spring = CantileverSpring(
        "bar",
        "tip_joint",
        (0.0, 0.0, 1.0),
        bending_stiffness=YOUNG * INERTIA,
        torsional_stiffness=SHEAR * 0.1406 * SIDE**4,
        length=length,
        axial_stiffness=YOUNG * AREA,
        elements=elements,
        shear_stiffness=COWPER * SHEAR * AREA if shear else None,
        mass=bar,
    )
    return vibrating_system(ElasticModel(robot, [spring]), np.zeros(2), damping=Damping(ratio=RATIO))


def _calculix(folder: Path, length: float, frequencies: list[float]) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the deflection per lateral force at the tip [m/N], six natural frequencies [Hz], and receptances there."""
    count = 20
    nodes = [f"{k + 1},0,0,{length * k / count!r}" for k in range(count + 1)]
    beams = [f"{k + 1},{2 * k + 1},{2 * k + 2},{2 * k + 3}" for k in range(count // 2)]
    sweep = "\n".join(
        f"*STEP\n*STEADY STATE DYNAMICS\n{f!r},{f!r},2\n*MODAL DAMPING\n1,12,{RATIO}\n*CLOAD\n{count + 1},1,1.\n"
        f"*NODE PRINT,NSET=TIP\nU\n*END STEP"
        for f in frequencies
    )
    (folder / "leg.inp").write_text(
        "\n".join(
            [
                *("*NODE,NSET=ALL", *nodes, "*NSET,NSET=TIP", str(count + 1), "*ELEMENT,TYPE=B32,ELSET=BAR", *beams),
                *("*ELEMENT,TYPE=MASS,ELSET=PLATFORM", f"1000,{count + 1}", "*MASS,ELSET=PLATFORM", repr(PLATFORM)),
                *("*MATERIAL,NAME=STEEL", "*ELASTIC", f"{YOUNG!r},{POISSON}", "*DENSITY", repr(DENSITY)),
                *("*BEAM SECTION,ELSET=BAR,MATERIAL=STEEL,SECTION=RECT", f"{SIDE},{SIDE}", "1,0,0"),
                *("*BOUNDARY", "1,1,6", "*STEP", "*STATIC", "*CLOAD", f"{count + 1},1,1."),
                *(
                    "*NODE PRINT,NSET=TIP",
                    "U",
                    "*END STEP",
                    "*STEP",
                    "*FREQUENCY,STORAGE=YES",
                    "12",
                    "*END STEP",
                    sweep,
                ),
            ]
        )
    )
    subprocess.run(["ccx", "leg"], cwd=folder, check=True, capture_output=True, timeout=120)
    lines = (folder / "leg.dat").read_text().splitlines()
    rows = [re.findall(r"[-+]?\d+(?:\.\d+E[-+]\d+)?", line) for line in lines]
    moved = [float(row[1]) for row in rows if len(row) == 4 and row[0] == str(count + 1)]
    natural = [float(row[3]) for row in rows if len(row) == 5 and row[0].isdigit()]
    swept = moved[-2 * len(frequencies) :]  # real and imaginary parts, after the static step and the modes' shapes
    return moved[0], np.array(natural[:6]), np.array(swept[::2]) + 1j * np.array(swept[1::2])


@pytest.mark.parametrize(("length", "allowed"), [(0.03, 0.08), (0.06, 0.02), (0.114, 0.02)])
def test_a_leg_bends_and_vibrates_as_in_calculix(tmp_path: Path, length: float, allowed: float) -> None:
    """From twice to eight times as long as thick: its elements, expanded to solids, know shear and the bar's mass."""
    one, many = _leg(length, 1), _leg(length, 16)
    first = float(one.frequencies[0])
    frequencies = [0.3 * first, 0.8 * first, 1.4 * first]
    deflection, natural, swept = _calculix(tmp_path, length, frequencies)
    for system in (one, many):
        tip = system.rows(["tool:x"])
        assert system.receptance([0.0], tip, tip).item().real == pytest.approx(deflection, rel=allowed)
        assert system.frequencies[:2] == pytest.approx(natural[:2], rel=allowed)
        found = system.receptance(frequencies, tip, tip)[:, 0, 0]
        np.testing.assert_allclose(found, swept, rtol=3.0 * allowed)  # near the mode, as its frequency differs
    if length == 0.03:
        slender = _leg(length, 1, shear=False)
        tip = slender.rows(["tool:x"])
        assert slender.receptance([0.0], tip, tip).item().real < 0.85 * deflection


def test_the_second_bending_mode_needs_elements(tmp_path: Path) -> None:
    _, natural, _ = _calculix(tmp_path, 0.114, [100.0])
    assert _leg(0.114, 16).frequencies[2:4] == pytest.approx(natural[2:4], rel=0.02)
