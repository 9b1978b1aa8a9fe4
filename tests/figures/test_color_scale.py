"""Colour scales and labels."""

from __future__ import annotations

import numpy as np
import pytest

from pm3dof_pin.figures.color_scale import axis_number, color_scale
from pm3dof_pin.figures.labels import display_unit, parameter_words


def test_decades_have_round_logarithmic_ticks() -> None:
    scale = color_scale(np.geomspace(2.0, 9e4, 500))
    assert scale.logarithmic
    assert len(scale.ticks) >= 4
    heads = {float(f"{tick:.0e}") / 10.0 ** np.floor(np.log10(tick)) for tick in scale.ticks}
    assert {round(head, 6) for head in heads} <= {1.0, 2.0, 5.0}
    assert scale.levels[0] <= 2.0
    assert scale.levels[-1] >= 9e4


def test_a_map_that_hardly_varies_says_so() -> None:
    assert color_scale(np.linspace(99.3, 100.7, 50)).note == "varies by 1.4 % of its mean"
    assert not color_scale(np.linspace(80.0, 120.0, 50)).note


def test_few_extreme_values_do_not_take_the_colours_from_the_others() -> None:
    values = np.concatenate([np.linspace(1.0, 2.0, 999), [50.0]])
    scale = color_scale(values)
    assert scale.extend == "max"
    assert scale.levels[-1] < 3.0
    assert scale.note == "values from 1 to 50"


def test_a_constant_has_one_colour() -> None:
    assert len(color_scale(np.full(5, 3.0) * (1.0 + 1e-15 * np.arange(5))).levels) == 2


@pytest.mark.parametrize(
    ("value", "unit", "expected"),
    [
        (4.4e-4, "m", (1e-6, "µm")),
        (0.2, "m", (1.0, "m")),
        (3.7e10, "N/m", (1e9, "kN/µm")),
        (1.3e8, "N m/rad", (1e6, "MN m/rad")),
        (2e-9, "m/N", (1e-9, "nm/N")),
        (800.0, "1", (1.0, "")),
        (6.3e9, "mixed", (1e9, "$10^{9}$ mixed units")),
    ],
)
def test_units_as_a_person_writes_them(value: float, unit: str, expected: tuple[float, str]) -> None:
    assert display_unit([value, np.nan], unit) == expected


def test_names_and_numbers() -> None:
    assert parameter_words("slider1_joint.tx") == "slider 1, along $x$"
    assert parameter_words("O_e.rz") == "$O_{e}$, about $z$"
    assert parameter_words("some name") == "some name"
    assert (axis_number(1500.0), axis_number(0.05), axis_number(1e9)) == ("1500", "0.05", "$10^{9}$")


@pytest.mark.parametrize("ends", [(247.0, 303.0), (0.0517, 0.1093), (54.1, 61.7), (18.41, 21.13)])
def test_ticks_are_round(ends: tuple[float, float]) -> None:
    """Multiples of 1, 2 or 5 times a power of ten, few enough to be read."""
    ticks = np.array(color_scale(np.linspace(*ends, 50)).ticks)
    step = ticks[1] - ticks[0]
    assert float(f"{step:.0e}") == pytest.approx(step, rel=1e-9)
    assert f"{step:.0e}"[0] in "125"
    np.testing.assert_allclose(ticks / step, np.round(ticks / step), atol=1e-6)
    assert 3 <= len(ticks) <= 9
