"""The statements about the printed ranges, against closed forms and random poses."""

from __future__ import annotations

import numpy as np
import pytest

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.limits import LIMIT_NAMES, limit_flags
from pm3dof_pin.maps.chapter_workspace import RangeStatement, compare_printed_ranges
from pm3dof_pin.maps.workspace import Workspace


@pytest.fixture(scope="module")
def statements(tripod: Tripod, tripod_workspace: Workspace) -> dict[str, RangeStatement]:
    return {statement.subject: statement for statement in compare_printed_ranges(tripod, tripod_workspace)}


def test_heights(statements: dict[str, RangeStatement]) -> None:
    statement = statements["z_e"]
    assert statement.printed == (0.440, 0.608)
    assert statement.computed == pytest.approx((0.3972, 0.5775), abs=5e-5)
    assert statement.unit == "m"
    assert "0.3972 to 0.5775 m, printed 0.440 to 0.608 m" in statement.text


def test_slider_travel_at_the_printed_heights(statements: dict[str, RangeStatement]) -> None:
    statement = statements["slider_travel"]
    assert statement.printed == pytest.approx((0.155272, 0.325272))
    for u, z_e in zip(statement.computed, (0.440, 0.608), strict=True):
        # Pythagoras in the plane of one leg, Table 8.1
        across = 0.37425 - 0.075 - u * np.cos(np.radians(50.0))
        assert np.hypot(across, z_e + 0.013 - u * np.sin(np.radians(50.0))) == pytest.approx(0.353, abs=1e-12)
    assert statement.computed[1] > statement.printed[1] + 0.03


def test_tilts(statements: dict[str, RangeStatement], tripod_workspace: Workspace) -> None:
    for axis, name in enumerate(("theta_x", "theta_y")):
        statement = statements[name]
        assert statement.printed == pytest.approx(np.radians([-40.0, 40.0]))
        assert statement.computed[:2] == pytest.approx(tripod_workspace.ranges[axis])
    assert np.degrees(statements["theta_x"].computed) == pytest.approx([-40.49, 44.72, 38.1], abs=0.1)
    assert np.degrees(statements["theta_y"].computed) == pytest.approx([-40.46, 40.46, 40.4], abs=0.1)
    assert "runs from -40.5 deg" in statements["theta_x"].text


def test_box(tripod: Tripod, statements: dict[str, RangeStatement]) -> None:
    filled, inside = statements["box"].computed
    generator = np.random.default_rng(9)
    tilt = np.radians(40.0)
    box = generator.uniform([-tilt, -tilt, 0.440], [tilt, tilt, 0.608], (60_000, 3))
    assert filled == pytest.approx(np.mean(limit_flags(tripod, box) == 0), abs=5e-3)
    around = generator.uniform([-0.8, -0.8, 0.397], [0.8, 0.8, 0.578], (120_000, 3))
    reachable = around[limit_flags(tripod, around) == 0]
    in_box = np.all(np.abs(reachable[:, :2]) <= tilt, axis=1) & (reachable[:, 2] >= 0.440)
    assert inside == pytest.approx(np.mean(in_box), abs=5e-3)


def test_binding_limits(statements: dict[str, RangeStatement]) -> None:
    shares = dict(zip(LIMIT_NAMES, statements["binding_limits"].computed, strict=True))
    assert {limit for limit, share in shares.items() if share} == {"stroke", "spherical"}
    assert statements["binding_limits"].text.endswith("never: reach, universal, tilt, height")
