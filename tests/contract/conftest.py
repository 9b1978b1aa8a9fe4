"""Every robot: those that come with the package, and external files in several dialects."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

MACHINES = Path(__file__).parents[1] / "machines"


@dataclass(frozen=True)
class Case:
    """A robot of the contract.

    Attributes:
        name: its name.
        options: command line options that select it.
        axes: two coordinates and the half width of a map about home on each, in the command line's units.
        springs: whether its description has springs.
        tool: whether it has a single tool frame.
    """

    name: str
    options: tuple[str, ...]
    axes: tuple[tuple[str, float], ...]
    springs: bool = True


CASES = (
    Case("pm3dof", ("--robot", "pm3dof"), (("theta_x", 10.0), ("theta_y", 10.0))),
    Case("hexapod", ("--robot", "hexapod"), (("x", 0.004), ("rz", 2.0))),
    Case("three_rps", ("--robot", "three_rps"), (("rx", 3.0), ("ry", 3.0))),
    Case("linear_delta", ("--robot", "linear_delta"), (("x", 0.03), ("y", 0.03))),
    Case("delta", ("--robot", str(MACHINES / "delta" / "delta.urdf")), (("x", 0.03), ("y", 0.03))),
    Case("five_bar", ("--robot", str(MACHINES / "five_bar")), (("x", 0.02), ("y", 0.02))),
    Case("three_rpr", ("--robot", str(MACHINES / "three_rpr")), (("px", 0.01), ("py", 0.01))),
    Case("four_bar", ("--robot", str(MACHINES / "four_bar" / "four_bar.closures.yaml")), (("crank_joint", 20.0),)),
    Case(
        "walker",
        ("--robot", str(MACHINES / "walker/walker.xml"), "--tool-frame", "left_sole"),
        (("left_hip_drive", 2.0), ("left_knee_drive", 2.0)),
        springs=False,
    ),
    Case("ur5", ("--robot", "ur5", "--tool-frame", "tool0"), (("x", 0.02), ("y", 0.02)), springs=False),
)


@dataclass(frozen=True)
class Done:
    """Result of a command.

    Attributes:
        status: its exit status.
        out: what it printed.
        err: its messages.
    """

    status: int
    out: str
    err: str

    @property
    def json(self) -> dict[str, Any]:
        """What it printed, as an object."""
        result: dict[str, Any] = json.loads(self.out)
        return result


@pytest.fixture(params=CASES, ids=lambda case: case.name)
def case(request: pytest.FixtureRequest) -> Case:
    if request.param.name == "ur5":
        pytest.importorskip("example_robot_data_loaders")
    chosen: Case = request.param
    return chosen


@pytest.fixture
def pm3dof(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path) -> Callable[..., Done]:
    """Run a command in an empty folder, in process, and check its exit status."""
    from pm3dof_pin.cli.app import main

    monkeypatch.chdir(tmp_path)

    def run(*words: object, status: int = 0) -> Done:
        monkeypatch.setattr(sys, "argv", ["pm3dof", *map(str, words)])
        capfd.readouterr()
        code = 0
        try:
            main()
        except SystemExit as end:
            code = int(end.code or 0)
        out, err = capfd.readouterr()
        assert code == status, f"pm3dof {' '.join(map(str, words))}: status {code}\n{out[-2000:]}\n{err[-2000:]}"
        return Done(code, out, err)

    return run
