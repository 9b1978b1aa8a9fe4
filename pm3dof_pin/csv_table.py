"""A CSV file of numbers: columns by name in metres and radians, the line of every row, and warnings.

Typical output of instruments and spreadsheets is understood: a byte order mark, semicolons or tabs between columns,
decimal commas with these, empty lines and lines that start with #, and columns in other units according to the suffix
of their names, `x_mm` or `rz_deg`.
"""

from __future__ import annotations

import csv
import itertools
import logging
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from pm3dof_pin.arrays import MAX_MAGNITUDE
from pm3dof_pin.exceptions import DescriptionError, MeasurementError, lines_in_words
from pm3dof_pin.files import csv_text, read_text, without_apostrophe
from pm3dof_pin.typing import Array, Mask

logger = logging.getLogger(__name__)

_UNITS = {
    "mm": ("m", 1e-3),
    "um": ("m", 1e-6),
    "in": ("m", 0.0254),
    "deg": ("rad", np.pi / 180.0),
    "mrad": ("rad", 1e-3),
    "urad": ("rad", 1e-6),
    "ms": ("s", 1e-3),
    "us": ("s", 1e-6),
    "min": ("s", 60.0),
    "h": ("s", 3600.0),
}
_OF_TIME_ALONE = ("us", "min", "h")  # `x_min` is no time
_CONDITIONS = ("temperature_", "load_", "rise_", "gradient_")


def csv_of_columns(columns: Mapping[str, Array]) -> str:
    """Return columns of numbers, shape=(n,) each, as CSV at full precision; NaN is an empty cell."""
    return csv_text([list(columns), *np.column_stack(list(columns.values())).tolist()])


def usual_orders(count: int) -> list[tuple[int, ...]]:
    """Return the orders that columns take by mistake, as what each holds: cyclic, two exchanged, reversed."""
    every = tuple(range(count))
    pairs = [tuple({a: b, b: a}.get(k, k) for k in every) for a, b in itertools.combinations(every, 2)]
    return [*(every[k:] + every[:k] for k in every[1:]), *pairs, every[::-1]]


def is_condition(column: str) -> bool:
    """Tell whether a column is a temperature or a load."""
    return column.startswith(_CONDITIONS)


class CsvTable:
    """Columns of numbers in metres and radians with a header; empty cells are NaN.

    Attributes:
        path: the file.
        header: the names of the columns in these units, in the order of the file.
        written: the columns by the headings of the file, in its units, shape=(n,) each.
        header_line: the line of the header.
        lines: the line of each row.
        columns: shape=(n,) each, by name.
        warnings: warnings about the file.
    """

    def __init__(
        self,
        path: Path,
        needed: Sequence[str],
        *,
        headings: Sequence[str] = (),
        words: Collection[str] = (),
        text: str | None = None,
        added: int = 0,
    ) -> None:
        """Read a file; without the columns `needed` it is rejected at once.

        Args:
            path: the file.
            needed: columns in metres and radians that it must have.
            headings: those of a file whose first line has numbers, in which blanks may separate columns.
            words: columns of words, which are not read.
            text: the text of the file, if it was read before.
            added: number of lines at its beginning that the file does not have.

        Raises:
            MeasurementError: it is unreadable, a column has no name, is duplicated or missing, or a cell is not a
                number.
        """
        self.path = path
        self.warnings: list[str] = []
        try:
            text = read_text(path) if text is None else text
        except DescriptionError as error:
            raise MeasurementError(path, error.expected) from error
        # an empty line for a comment keeps the numbers of the lines
        lines = ["" if line.lstrip().startswith("#") else line for line in text.splitlines()]
        first = next((line for line in lines if line.strip()), "")
        if headless := bool(headings) and _is_numbers(first):
            lines = [",".join(line.partition("#")[0].replace(",", " ").split()) for line in lines]
            first = ","
        separator = next((mark for mark in ";\t" if mark in first and "," not in first), ",")
        self._decimal_commas = separator != ","
        reader = csv.reader(lines, delimiter=separator)
        self.lines: list[int] = []
        rows: list[list[float]] = []
        try:
            if not headless:
                header = next((cells for cells in reader if any(cells)), [])
                headings = [without_apostrophe(name.strip()) for name in header]
            self.header, factors = self._in_si(headings)
            self.header_line = max(reader.line_num - added, 1)
            self._check_header(needed, self.header_line)
            read = [(k, name) for k, name in enumerate(self.header) if name not in words]
            start, numbers = reader.line_num, self._plain_numbers(lines[reader.line_num :], read)
            if numbers is not None:
                self.lines = [n - added for n, line in enumerate(lines[start:], start=start + 1) if line]
            for cells in reader if numbers is None else ():
                if not any(cell.strip() for cell in cells):
                    continue
                if len(cells) != len(self.header):
                    what = f"numbers: {', '.join(headings)}" if headless else "as in the header"
                    problem = f"{len(cells)} cells, expected {len(self.header)} {what}"
                    raise MeasurementError(path, problem, [reader.line_num - added])
                self.lines.append(reader.line_num - added)
                rows.append([self._number(cells[k], name) for k, name in read])
        except csv.Error as error:
            raise MeasurementError(path, f"expected CSV ({error})", [reader.line_num - added]) from error
        table = np.array(rows, dtype=float).reshape(len(rows), len(read)) if numbers is None else numbers
        kept = [k for k, _ in read]
        self.written: dict[str, Array] = {headings[k]: column for k, column in zip(kept, table.T, strict=True)}
        self.columns: dict[str, Array] = dict(zip((n for _, n in read), (table * factors[kept]).T, strict=True))

    def __len__(self) -> int:
        return len(self.lines)

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]

    def get(self, name: str, value: float) -> Array:
        """Return a column, or `value` in every row if there is no column of this name."""
        return self.columns.get(name, np.full(len(self), value))

    def matrix(self, names: Sequence[str], missing: float | None = None) -> Array:
        """Return columns side by side, shape=(n, len(names)); all `missing` if the first one is not there."""
        if missing is not None and names and names[0] not in self:
            return np.full((len(self), len(names)), missing)
        return np.column_stack([np.empty((len(self), 0)), *(self.columns[name] for name in names)])

    def conditions(self) -> dict[str, Array]:
        """Return temperatures and loads by the name of their column, shape=(n,) each.

        Raises:
            MeasurementError: a value is missing in some row.
        """
        found = {name: values for name, values in self.columns.items() if is_condition(name)}
        for name, values in found.items():
            if not np.isfinite(values).all():
                raise MeasurementError(self.path, f"{name} is missing", self.lines_where(~np.isfinite(values)))
        return found

    def require(self, names: Sequence[str], line: int = 1) -> None:
        """Check that columns exist; the header is on a given line.

        Raises:
            MeasurementError: some do not.
        """
        missing = [name for name in names if name not in self.header]
        if missing:
            problem = (
                f"no column {', '.join(missing)}; expected {','.join(names)}, the file has {','.join(self.header)}"
            )
            raise MeasurementError(self.path, problem, [line])

    def keep(self, flags: Mask) -> None:
        """Keep only the flagged rows, with a warning about the others.

        Raises:
            MeasurementError: none is left.
        """
        if not flags.all():
            self.warn("numbers are missing or not finite; left out", self.lines_where(~flags))
        if not flags.any():
            raise MeasurementError(self.path, "no complete row of numbers, expected one for each pose")
        for columns in (self.columns, self.written):
            columns |= {name: values[flags] for name, values in columns.items()}
        self.lines = self.lines_where(flags)

    def lines_where(self, flags: Any) -> list[int]:
        """Return the lines of the rows that are flagged."""
        return [self.lines[row] for row in np.flatnonzero(flags)]

    def warn(self, text: str, lines: Sequence[int] = ()) -> None:
        """Store and log a warning."""
        self.warnings.append(f"{lines_in_words(lines)}{text}")
        logger.warning("%s: %s", self.path, self.warnings[-1])

    @staticmethod
    def _in_si(header: Sequence[str]) -> tuple[list[str], Array]:
        """Return the column names in metres and radians, and the factors that convert their numbers."""
        names, factors = [*header], np.ones(len(header))
        for k, name in enumerate(header):
            stem, _, unit = name.rpartition("_")
            if unit in _UNITS and not is_condition(name) and (stem == "time" or unit not in _OF_TIME_ALONE):
                names[k], factors[k] = f"{stem}_{_UNITS[unit][0]}", _UNITS[unit][1]
        return names, factors

    def _check_header(self, needed: Sequence[str], line: int) -> None:
        header = self.header
        if len(header) == 1 and (found := next((mark for mark in "| " if mark in header[0]), "")):
            problem = f"columns are separated by {found!r}, expected commas, semicolons or tabs"
            raise MeasurementError(self.path, problem, [line])
        if "" in header:
            problem = f"column {header.index('') + 1} has no name: a comma at the end of the lines?"
            raise MeasurementError(self.path, problem, [line])
        self.require(needed, line)
        if twice := sorted({name for name in header if header.count(name) > 1}):
            raise MeasurementError(self.path, f"column {', '.join(twice)} appears more than once", [line])

    def _plain_numbers(self, lines: Sequence[str], read: Sequence[tuple[int, str]]) -> Array | None:
        """Return the numbers of lines that have nothing else, as those of most long files; None for others."""
        if self._decimal_commas or len(read) < len(self.header):
            return None
        if any("_" in line or '"' in line or not line.isascii() for line in lines):
            return None
        with suppress(ValueError):
            numbers = np.loadtxt(lines, delimiter=",", comments=None, ndmin=2) if any(lines) else np.zeros((0, 0))
            # too large or infinite: the words tell
            return numbers if numbers.shape[1] == len(read) and not (np.abs(numbers) > MAX_MAGNITUDE).any() else None
        return None

    def _number(self, cell: str, column: str) -> float:
        word = without_apostrophe(cell.strip())
        try:
            number = plain_number(word.replace(",", ".") if self._decimal_commas else word) if word else np.nan
        except ValueError as error:
            digits = "" if word.isascii() else " in digits 0 to 9"
            problem = f"{column} is '{word}', expected a number{digits}"
            raise MeasurementError(self.path, problem, [self.lines[-1]]) from error
        if abs(number) > MAX_MAGNITUDE and any(letter.isdigit() for letter in word):  # "inf" is meant as such
            problem = f"{column} is '{word}', expected a number of at most {MAX_MAGNITUDE:g}"
            raise MeasurementError(self.path, problem, [self.lines[-1]])
        return number


def plain_number(word: str) -> float:
    """Return the number that a word is; raise ValueError for others, such as digits of other scripts."""
    if not word.isascii() or "_" in word:
        raise ValueError(word)
    return float(word)


def _is_numbers(line: str) -> bool:
    """Tell whether a line has numbers, and no names."""
    try:
        return bool([float(word) for word in line.partition("#")[0].replace(",", " ").split()])
    except ValueError:
        return False
