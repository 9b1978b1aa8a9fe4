"""Exports of instruments and controllers, rewritten as plain measurement files: same lines, known headings.

Understood without being told: UTF-8, UTF-16, and Latin-1 in headings; comments (#, //, %) and other lines before the
header, or a header within a comment; `sep=;`; semicolons, tabs and decimal commas; a comma at the end of lines; units
in headings, `X [mm]`, `X (mm)`, `X mm`, `X_mm`, or in a row below them; headers repeated further down; capital
letters; times as ISO 8601; columns of words. A :class:`ColumnMap` says the rest: other names, the order of Euler
angles, a missing header.
"""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Literal, get_args

from pm3dof_pin.csv_table import CsvTable, is_condition, plain_number
from pm3dof_pin.description.yaml_file import read_mapping
from pm3dof_pin.exceptions import DescriptionError, InvalidValueError, MeasurementError
from pm3dof_pin.files import csv_text, read_bytes, without_apostrophe
from pm3dof_pin.measuring.angles import AngleOrder
from pm3dof_pin.measuring.clock_times import replace_times

IGNORE = "ignore"
"""In place of a column's name: the column is not used."""

_SIMPLE = re.compile(
    r"x|y|z|q[wxyz]|p[xyz]|c[xyz]|r[xyz]|euler[123]|(from_|approach_)?u\d+|distance|height|sphere|plane|line|socket|camera|time"
    r"|(image|focal|centre)_[uv]_px|sigma_image_px|sigma_(x|y|z|rx|ry|rz|distance|touch)"
)
_WITHOUT_UNIT = re.compile(r".*_px|q[wxyz]|sphere|plane|line|socket|camera|time|approach_u\d+")
_UNITS = {
    "m": ("m", "meter", "meters", "metre", "metres"),
    "mm": ("mm", "millimeter", "millimeters", "millimetre", "millimetres"),
    "um": ("um", "µm", "μm", "micron", "microns", "micrometer", "micrometre"),
    "in": ("in", "inch", "inches"),
    "rad": ("rad", "radian", "radians"),
    "deg": ("deg", "°", "degree", "degrees"),
    "mrad": ("mrad",),
    "urad": ("urad", "µrad", "μrad"),
    "s": ("s", "sec", "second", "seconds"),
    "ms": ("ms", "millisecond", "milliseconds"),
    "us": ("us", "µs", "μs"),
    "min": ("min", "minute", "minutes"),
    "h": ("h", "hour", "hours"),
}
_UNIT_OF = {word: unit for unit, words in _UNITS.items() for word in words}
_BRACKETS = re.compile(r"(.*?)[\s_]*[\[(]\s*([^\[\]()]*?)\s*[\])]")
_AT_THE_END = re.compile(r"(.*\S)[\s_/]+(\S+)")
_OF_DRIVES = ("", "from_", "approach_")
_TIMES = ("time", "timestamp", "time_stamp", "date_time", "datetime", "t", "elapsed", "elapsed_time", "relative_time")
"""Headings of times, the first that a file has being used; those after `datetime` only with a unit of time."""
_WITH_UNIT_ONLY, _OF_TIME = _TIMES[5:], ("s", "ms", "us", "min", "h")
_COMMENTS = ("#", "//", "%")
_MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
_LATIN = b"\xb0\xb5"  # degree and micro signs, all that is guessed of a text that is not UTF-8
_BLANKS = "blanks"


@dataclass(frozen=True)
class ColumnMap:
    """What a file does not say of itself. Everything is optional.

    Example:
        >>> from pm3dof_pin.measuring.export_file import ColumnMap
        >>> ColumnMap({"Axis1": "u1_deg", "Roll": "rx_deg"}, angles="fixed xyz").name_of("Axis1")
        'u1_deg'
    """

    #: headings of the file and the columns they are, with the file's unit: {"Axis 1": "u1_deg"}; a unit in the heading
    #: prevails; "ignore" for a column that is not used
    columns: Mapping[str, str] = field(default_factory=dict)
    header: tuple[str, ...] = ()  #: headings of a file that has none
    skip: int = 0  #: lines before the header
    encoding: str = ""  #: of the text, as Python names it; otherwise recognised
    separator: str = ""  #: between cells: one character, or "blanks"; otherwise recognised
    decimal: str = ""  #: "." or ","; otherwise commas are decimal unless they separate cells
    angles: AngleOrder | Literal[""] = (
        ""  #: order of rx, ry, rz, or of euler1, euler2, euler3; see :data:`~pm3dof_pin.measuring.angles.AngleOrder`
    )

    def __post_init__(self) -> None:
        """Check what has few possible values."""
        if self.angles not in ("", *get_args(AngleOrder)):
            raise InvalidValueError("angles", self.angles, f"one of {', '.join(get_args(AngleOrder))}")
        if self.decimal not in ("", ".", ","):
            raise InvalidValueError("decimal", self.decimal, '"." or ","')
        if self.separator != _BLANKS and len(self.separator) > 1:
            raise InvalidValueError("separator", self.separator, f"one character, or {_BLANKS}")
        if self.skip < 0:
            raise InvalidValueError("skip", self.skip, "a number of lines")
        if self.encoding:
            try:
                codecs.lookup(self.encoding)
            except LookupError:
                raise InvalidValueError("encoding", self.encoding, "one that Python knows, such as utf-16") from None

    @classmethod
    def load(cls, which: Path | str) -> ColumnMap:
        """Return a profile of :data:`PROFILES` by name, or read a YAML file with the attributes of this class.

        A file may start from a profile: `profile: kuka`.

        Raises:
            DescriptionError: the file is unreadable, or has a key or value that is not expected.
        """
        if str(which) in PROFILES:
            return PROFILES[str(which)]
        path = Path(which)
        if not path.is_file():
            raise DescriptionError(path, "columns", f"expected a file, or one of {', '.join(PROFILES)}")
        data = read_mapping(path)
        kinds = {"columns": dict, "header": list, "skip": int, "profile": str}
        names = [entry.name for entry in fields(cls)]
        if wrong := [str(key) for key in data if key not in (*names, "profile")]:
            expected = f"expected some of {', '.join([*names, 'profile'])}, not {', '.join(wrong)}"
            raise DescriptionError(path, "columns", " ".join(expected.split()))
        for key, value in data.items():
            kind, words = kinds.get(key, str), list[object]()
            if isinstance(value, dict | list):
                words = [*value, *(value.values() if isinstance(value, dict) else ())]
            if type(value) is not kind or any(not isinstance(word, str) for word in words):
                of = " of words" if kind in (dict, list) else ""
                raise DescriptionError(path, key, f"expected a {kind.__name__}{of}, not {value!r}")
        profile = data.pop("profile", None)
        if profile is not None and profile not in PROFILES:
            raise DescriptionError(path, "profile", f"expected one of {', '.join(PROFILES)}, not {profile}")
        start = {entry.name: getattr(PROFILES.get(profile or "", cls()), entry.name) for entry in fields(cls)}
        data["columns"] = {**start["columns"], **data.get("columns", {})}
        data["header"] = tuple(data.get("header", start["header"]))
        try:
            return cls(**(start | data))
        except InvalidValueError as error:
            raise DescriptionError(path, "columns", str(error)) from error

    def name_of(self, heading: str) -> str:
        """Return the column that a heading stands for: its known name with unit, or the heading as it is."""
        whole = _plain(heading)
        stem, unit = _split(whole)
        known = {_plain(name).casefold(): column for name, column in self.columns.items()}
        column = known.get(whole.casefold(), known.get(stem.casefold(), ""))
        if column:
            own, given = _split(column)
            return f"{own}_{unit}" if unit and given and whole.casefold() not in known else column
        simple = re.sub(r"\s+", "_", stem).lower()
        if simple in _TIMES and (unit in _OF_TIME or simple not in _WITH_UNIT_ONLY):
            simple = "time"
        if not _SIMPLE.fullmatch(simple):
            return heading
        return f"{simple}_{unit}" if unit else simple


def _six(name: str, unit: str) -> dict[str, str]:
    return {name.format(k): f"u{k}_{unit}" for k in range(1, 7)}


_MILLIMETRES = {axis: f"{axis.lower()}_mm" for axis in "XYZ"}

PROFILES: dict[str, ColumnMap] = {
    "abb": ColumnMap(
        {**_MILLIMETRES, **dict(zip(("q1", "q2", "q3", "q4"), ("qw", "qx", "qy", "qz"), strict=True))}
        | _six("J{}", "deg")
        | _six("rax_{}", "deg")
    ),
    "fanuc": ColumnMap(
        _MILLIMETRES | {"W": "rx_deg", "P": "ry_deg", "R": "rz_deg"} | _six("J{}", "deg"), angles="fixed xyz"
    ),
    "kuka": ColumnMap(
        _MILLIMETRES | {"A": "rz_deg", "B": "ry_deg", "C": "rx_deg"} | _six("A{}", "deg"), angles="moving zyx"
    ),
    "spatialanalyzer": ColumnMap(
        _MILLIMETRES
        | {"Rx": "rx_deg", "Ry": "ry_deg", "Rz": "rz_deg", "Timestamp": "time_s"}
        | dict.fromkeys(("Collection", "Group", "Target", "Point", "Frame", "Name", "Offset", "Offset 2"), IGNORE),
        angles="fixed xyz",
    ),
    "universal-robots": ColumnMap(
        {"timestamp": "time_s"}
        | {f"actual_TCP_pose_{k}": name for k, name in enumerate(("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad"))}
        | {f"actual_q_{k}": f"u{k + 1}_rad" for k in range(6)},
        angles="rotation vector",
    ),
}
"""Column maps of usual exports, by name."""


@dataclass(frozen=True)
class Export:
    """A file as it came, rewritten with commas, decimal points and known headings."""

    path: Path  #: the file
    text: str  #: the rewritten file; each row is on its own line of the file
    words: frozenset[str]  #: columns that hold words
    headings: Mapping[str, str]  #: columns and the headings of the file that they were
    encoding: str  #: of the file
    separator: str  #: between its cells
    decimal: str  #: its decimal mark
    header_line: int  #: the line of the header; 0 if the file has none
    rows: int  #: number of rows

    @classmethod
    def read(
        cls,
        path: Path,
        needed: Collection[str],
        columns: ColumnMap | None = None,
        drives: Mapping[str, str] | None = None,
    ) -> Export:
        """Read a file; its header is the first line that has the columns `needed`, in any unit.

        Columns of commands may also have the names of the drives: `m1_deg` for `u1_deg` if `drives` has m1: u1.

        Raises:
            MeasurementError: it is unreadable, is not text in a known encoding, has a row of another length, a time
                that is none, a column of lengths or angles without a unit, or a command twice.
        """
        given = columns or ColumnMap()
        names_of = (drives or {}).items()
        numbers = {f"{what}{name}".casefold(): f"{what}{number}" for name, number in names_of for what in _OF_DRIVES}

        def name_of(heading: str) -> str:
            name = given.name_of(without_apostrophe(heading.strip()))
            stem, unit = _split(name)
            if _SIMPLE.fullmatch(stem) or (number := numbers.get(stem.casefold())) is None:
                return name
            return f"{number}_{unit}" if unit else number

        text, encoding = _decoded(path, given.encoding)
        lines = [line.replace("\0", "") for line in text.splitlines()]
        if "\0" in text:
            raise MeasurementError(path, "has null bytes, expected text", [1 + text[: text.index("\0")].count("\n")])
        separator = given.separator
        if lines and (told := re.fullmatch(r"sep=(.)", lines[0].strip())):
            separator, lines[0] = separator or told[1], ""
        lines[: given.skip] = [""] * min(given.skip, len(lines))
        stems = {_split(name)[0] for name in needed}
        if given.header:
            first, header_line = next((line for line in lines if _is_row(line)), ""), 0
            separator = separator or _separator(first)
            headings: Sequence[str] = given.header
        else:
            header_line, headings, separator = _header(lines, separator, name_of, stems)
        decimal = given.decimal or ("." if separator == "," else ",")
        rows = _rows(path, lines, header_line, separator)
        headings, rows = _without_headings(path, headings, rows)
        names = _with_one_time(headings, [name_of(heading) for heading in headings])
        names, rows = _without_last(path, header_line, names, rows)
        kept = [k for k, name in enumerate(names) if name != IGNORE]
        headed = [names[k] for k in kept]
        cells = {line: [row[k].strip() for k in kept] for line, row in rows.items()}
        for k, name in enumerate(headed):
            if _split(name)[0] == "time" and replace_times(path, cells, k):
                headed[k] = "time_s"
        bare = [
            headings[kept[k]]
            for k, name in enumerate(headed)
            if _SIMPLE.fullmatch(name) and not _WITHOUT_UNIT.fullmatch(name)
        ]
        if bare:
            problem = f"{', '.join(bare)} without a unit: expected headings such as {bare[0]} [mm], or --columns"
            raise MeasurementError(path, problem, [max(header_line, 1)])
        for number in dict.fromkeys(numbers.values()):
            same = [headings[kept[k]].strip() for k, name in enumerate(headed) if _split(name)[0] == number]
            if len(set(same)) > 1:
                problem = f"{', '.join(same)}: expected one column of {number}"
                raise MeasurementError(path, problem, [max(header_line, 1)])
        if decimal == ",":
            cells = {line: [cell.replace(",", ".") for cell in row] for line, row in cells.items()}
        known = [bool(_SIMPLE.fullmatch(_split(name)[0]) or is_condition(name)) for name in headed]
        wordy = frozenset(
            name
            for k, name in enumerate(headed)
            if not known[k]
            and name not in needed
            and not name.removeprefix("sigma_").startswith("encoder_")
            and not _are_numbers(cells, k)
        )
        written = [""] * max([header_line, *cells, 1])
        for line, row in cells.items():
            written[line - 1] = csv_text([row]).rstrip("\r\n")
        top = csv_text([headed]).rstrip("\r\n")
        if header_line:
            written[header_line - 1] = top
        else:
            written.insert(0, top)
        found = dict(zip(headed, (headings[k] for k in kept), strict=True))
        return cls(path, "\n".join(written) + "\n", wordy, found, encoding, separator, decimal, header_line, len(cells))

    def table(self, needed: Sequence[str]) -> CsvTable:
        """Return the columns of numbers, in metres, radians and seconds; raises as :class:`CsvTable`."""
        return CsvTable(self.path, needed, words=self.words, text=self.text, added=int(self.header_line == 0))


def _with_one_time(headings: Sequence[str], names: list[str]) -> list[str]:
    """Return the names of columns, of several kinds of times only the first of :data:`_TIMES` as one."""

    def order(heading: str) -> int:
        simple = "_".join(_split(_plain(heading))[0].lower().split())
        return _TIMES.index(simple) if simple in _TIMES else -1

    ranks = [order(h) for h, name in zip(headings, names, strict=True) if _split(name)[0] == "time"]
    return [
        heading if _split(name)[0] == "time" and order(heading) > min(ranks) else name
        for heading, name in zip(headings, names, strict=True)
    ]


def _plain(heading: str) -> str:
    return " ".join(heading.strip().strip('"').split())


def _split(name: str) -> tuple[str, str]:
    """Return a heading without its unit, and the unit, "" if there is none."""
    for pattern in (_BRACKETS, _AT_THE_END):
        if (found := pattern.fullmatch(name)) and (unit := _UNIT_OF.get(found[2].lower())):
            return found[1].rstrip(" ,"), unit
    stem, _, unit = name.rpartition("_")
    return (stem, _UNIT_OF[unit.lower()]) if stem and unit.lower() in _UNIT_OF else (name, "")


def _decoded(path: Path, encoding: str) -> tuple[str, str]:
    try:
        content = read_bytes(path)
    except DescriptionError as error:
        raise MeasurementError(path, error.expected) from error
    if not encoding:
        encoding = next((name for mark, name in _MARKS.items() if content.startswith(mark)), "utf-8")
        bare = content[:200]
        if encoding == "utf-8" and len(bare) > 3 and (bare[1::2].count(0) > 0.4 * len(bare)):
            encoding = "utf-16-le"
    try:
        return content.decode(encoding), encoding
    except (UnicodeDecodeError, LookupError) as error:
        if encoding == "utf-8" and not {byte for byte in content if byte > 127} - set(_LATIN):
            return content.decode("latin-1"), "latin-1"
        where = f" (byte {error.start} is invalid)" if isinstance(error, UnicodeDecodeError) else ""
        line = 1 + content[: getattr(error, "start", 0)].count(b"\n")
        raise MeasurementError(path, f"expected {encoding.upper()} text{where}, or --columns", [line]) from error


def _is_row(line: str) -> bool:
    return bool(line.strip(" \t,;")) and not line.lstrip().startswith(_COMMENTS)


def _separator(line: str) -> str:
    if "," in line and ";" not in line:
        return ","
    return next((mark for mark in ";\t" if mark in line), ",")


def _cells(line: str, separator: str) -> list[str]:
    if separator == _BLANKS:
        return line.split()
    return next(csv.reader([line], delimiter=separator), [])


def _header(
    lines: list[str], separator: str, name_of: Callable[[str], str], stems: Collection[str]
) -> tuple[int, list[str], str]:
    """Return the line of the header, its headings, and what separates them; the first row if none has the columns."""
    found: list[tuple[int, list[str], str]] = []
    for in_comments in (False, True):
        for number, line in enumerate(lines, start=1):
            bare = line.lstrip()
            if in_comments != bare.startswith(_COMMENTS) or not bare.strip(" \t,;"):
                continue
            text = bare.lstrip("#/% \t") if in_comments else line
            mark = separator or _separator(text)
            try:
                headings = _cells(text, mark)
            except csv.Error:
                continue
            names = {_split(name_of(heading))[0] for heading in headings}
            if names >= set(stems) if stems else any(map(_SIMPLE.fullmatch, names)):
                return number, headings, mark
            if not in_comments:
                found.append((number, headings, mark))
    return found[0] if found else (1, [""], separator or ",")


def _rows(path: Path, lines: list[str], header_line: int, separator: str) -> dict[int, list[str]]:
    """Return the cells of the rows below the header, by line."""
    below = ["" if number <= header_line or not _is_row(line) else line for number, line in enumerate(lines, start=1)]
    if separator == _BLANKS:
        return {number: line.split() for number, line in enumerate(below, start=1) if line}
    reader, rows = csv.reader(below, delimiter=separator), {}
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                rows[reader.line_num] = cells
    except csv.Error as error:
        raise MeasurementError(path, f"expected CSV ({error})", [reader.line_num]) from error
    return rows


def _without_headings(
    path: Path, headings: Sequence[str], rows: dict[int, list[str]]
) -> tuple[Sequence[str], dict[int, list[str]]]:
    """Drop repeated headers, and a row of units below the header, which become part of headings without any."""
    same = [heading.strip() for heading in headings]
    rows = {line: row for line, row in rows.items() if [cell.strip() for cell in row] != same}
    first = next(iter(rows), 0)
    words = [cell.strip(" []()").lower() for cell in rows.get(first, ())]
    if any(words) and all(word in _UNIT_OF for word in words if word not in ("", "-")):
        del rows[first]
        told = dict(enumerate(words[: len(same)]))
        units = {k: _UNIT_OF[word] for k, word in told.items() if word in _UNIT_OF}
        for k, own in ((k, _split(same[k])[1]) for k in units):
            if own not in ("", units[k]):
                raise MeasurementError(path, f"{same[k]} is said to be in {units[k]}", [first])
        headings = [
            f"{name} [{told[k]}]" if k in units and not _split(name)[1] else name for k, name in enumerate(same)
        ]
    return headings, rows


def _without_last(
    path: Path, header_line: int, names: list[str], rows: dict[int, list[str]]
) -> tuple[list[str], dict[int, list[str]]]:
    """Drop empty cells at the end, which a separator there leaves, and check that the rows have equal lengths."""
    count = len(names)
    while count > 1 and not names[count - 1] and not any("".join(row[count - 1 :]).strip() for row in rows.values()):
        count -= 1
    rows = {line: row[:count] if not "".join(row[count:]).strip() else row for line, row in rows.items()}
    for line, row in rows.items():
        if len(row) != count:
            what = "as in the header" if header_line else "as in --columns"
            raise MeasurementError(path, f"{len(row)} cells, expected {count} {what}", [line])
    return names[:count], rows


def _are_numbers(cells: dict[int, list[str]], k: int) -> bool:
    def is_number(cell: str) -> bool:
        try:
            plain_number(cell or "nan")
        except ValueError:
            return False
        return True

    return all(is_number(row[k]) for row in cells.values())
