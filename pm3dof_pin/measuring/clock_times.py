"""Times of instruments and controllers as seconds: ISO 8601, with or without a zone, or of a clock without a date."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path

from pm3dof_pin.exceptions import MeasurementError

_CLOCK = re.compile(r"([01]?\d|2[0-3]):([0-5]\d)(?::([0-5]\d(?:\.\d*)?))?", re.ASCII)
_BEGIN = re.compile(r"\d{4}-\d\d-\d\d|\d\d?:\d\d", re.ASCII)
_DAY = 86400.0


def replace_times(path: Path, cells: dict[int, list[str]], k: int) -> bool:
    """Replace the times in column k of cells, by line of the file, by seconds; tell whether it has any.

    A clock without a date that falls back by more than half a day has passed midnight.

    Raises:
        MeasurementError: a cell is no such time, or some have a date or a zone and others none.
    """
    if not any(_BEGIN.match(row[k]) for row in cells.values()):
        return False
    zoned: dict[bool, int] = {}
    dated: dict[bool, int] = {}
    last, days = 0.0, 0.0
    for line, row in cells.items():
        word = row[k].replace(",", ".")
        if not word:
            continue
        try:
            clock = _CLOCK.fullmatch(word)
            dated.setdefault(clock is None, line)
            if clock:
                seconds = 3600.0 * int(clock[1]) + 60.0 * int(clock[2]) + float(clock[3] or 0.0)
                days += _DAY * (seconds + days < last - 0.5 * _DAY)
                last = seconds = seconds + days
            else:
                moment = datetime.fromisoformat(word)
                zoned.setdefault(moment.tzinfo is not None, line)
                seconds = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
        except ValueError as error:
            raise MeasurementError(path, f"'{row[k]}' is not a time, expected ISO 8601", [line]) from error
        row[k] = repr(seconds)
    if len(dated) > 1:
        raise MeasurementError(path, "some times have a date and others none", sorted(dated.values()))
    if len(zoned) > 1:
        raise MeasurementError(path, "some times have a zone and others none: hours apart?", sorted(zoned.values()))
    return True
