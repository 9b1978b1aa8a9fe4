"""Table 8.3: ten entries as printed, two off in the last digit, one inconsistent; an invalid table is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from pm3dof_pin.chapter.table_8_3 import TableRow, table_8_3
from pm3dof_pin.exceptions import DescriptionError

# As printed in the book, to its five digits.
PRINTED = {
    ("theta_x", "minimum"): "5.6056e+07",
    ("theta_x", "maximum"): "1.3026e+08",
    ("theta_x", "average"): "1.1461e+08",
    ("theta_y", "minimum"): "4.5293e+07",
    ("theta_y", "maximum"): "1.3140e+08",
    ("theta_y", "average"): "1.1088e+08",
    ("t_z", "minimum"): "3.6701e+10",
    ("t_z", "maximum"): "3.7756e+10",
    ("t_z", "average"): "3.7464e+10",
    ("t_x", "minimum"): "6.0793e+07",
    ("theta_z", "minimum"): "5.9621e+04",
    ("global", "minimum"): "6.1633e+09",
    ("global", "maximum"): "6.3544e+09",
    ("global", "average"): "6.3015e+09",
}
LAST_DIGIT = {("t_x", "minimum"): -1, ("global", "maximum"): 1}
MISPRINT = ("theta_y", "average")


@pytest.fixture(scope="module")
def rows() -> dict[tuple[str, str], TableRow]:
    return {(row.axis, row.statistic): row for row in table_8_3()}


def test_published_numbers_are_the_printed_ones(rows: dict[tuple[str, str], TableRow]) -> None:
    assert {key: f"{row.published:.4e}" for key, row in rows.items()} == PRINTED


def test_entries_met_exactly_as_printed(rows: dict[tuple[str, str], TableRow]) -> None:
    for key, printed in PRINTED.items():
        if key not in LAST_DIGIT and key != MISPRINT:
            assert f"{rows[key].computed:.4e}" == printed, key
            assert rows[key].last_digit_difference == 0


def test_two_entries_are_one_off_in_the_last_digit(rows: dict[tuple[str, str], TableRow]) -> None:
    for key, difference in LAST_DIGIT.items():
        assert rows[key].last_digit_difference == difference


def test_the_entry_that_contradicts_its_own_table(rows: dict[tuple[str, str], TableRow]) -> None:
    """The printed global average is the mean of six averages; solved for theta_y it is 1.0874e8 within its rounding."""
    row = rows[MISPRINT]
    assert f"{row.computed:.4e}" == "1.0880e+08"
    assert "contradicts its own table" in row.remark
    others = 1.1461e8 + 3.7464e10 + 2 * 6.0793e7 + 5.9621e4
    implied, rounding = 6 * 6.3015e9 - others, 6 * 0.5e5 + 0.5e6
    assert implied == pytest.approx(1.0874e8, abs=0.0001e8)
    assert abs(implied - row.computed) < rounding
    assert abs(implied - row.published) > 2 * rounding


def test_differences_are_relative_to_the_published(rows: dict[tuple[str, str], TableRow]) -> None:
    for row in rows.values():
        assert row.relative_difference == pytest.approx(row.computed / row.published - 1.0, abs=1e-15)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("rows: 3", "rows: expected a list of mappings"),
        ("rows: [{axis: colour, minimum: 1.0}]", "axis 'colour'"),
        ("rows: [{axis: t_z, minimum: much}]", "t_z.minimum: 'much' is not a number"),
    ],
)
def test_a_bad_table_is_refused(text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "table.yaml"
    path.write_text(text)
    with pytest.raises(DescriptionError, match=words):
        table_8_3(published=path)
