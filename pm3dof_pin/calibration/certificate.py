"""A report to sign: what is stated of a machine, with expanded uncertainty and decision rule, and what is not claimed.

What the calibration cannot know comes from a YAML file: the machine and the instrument with their serial numbers and
certificates, date, temperature, procedure, who signs, and limits to decide on. Statements come from a calibration's
folder and from acceptance tests. U is the expanded uncertainty, k = 2; with a limit T the decision rule is

    simple           conforms if value <= T,
    guarded          conforms if value + U <= T, does not if value - U > T, otherwise undecided (ISO 14253-1).

The bound by the calibration already contains its uncertainty, so it has no U: guarded, it conforms if it is <= T, and
is otherwise undecided. It is exceeded by one pose in twenty, and these count in the root mean square over all poses.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import date
from html import escape
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal

from pm3dof_pin.calibration.acceptance import AcceptanceResult, is_finite_number
from pm3dof_pin.calibration.folder import checksum_of, read_summary
from pm3dof_pin.csv_table import plain_number
from pm3dof_pin.description.yaml_file import read_mapping
from pm3dof_pin.exceptions import DescriptionError, InvalidValueError
from pm3dof_pin.figures.html_page import html_page, html_table

DecisionRule = Literal["simple", "guarded"]

_TEXT = {"type": "string", "minLength": 1}
_ITEM_KEYS = ("name", "serial_number", "certificate", "calibrated_until")
_ITEM = {
    "type": "object",
    "required": ["name", "serial_number"],
    "additionalProperties": False,
    "properties": dict.fromkeys(_ITEM_KEYS, _TEXT),
}
_NUMBER_OR_NONE = {"type": ["number", "null"]}
_DATE = "^\\d{4}-\\d{2}-\\d{2}$"
SCHEMA: dict[str, Any] = {
    "$schema": "https://json-schema.org/draft/2020-12/schema",
    "title": "Calibration report of pm3dof_pin",
    "type": "object",
    "required": [
        *("robot", "date", "machine", "instrument", "temperature_C", "procedure", "versions", "calibration_sha256"),
        *("decision_rule", "statements", "not_claimed", "signed_by"),
    ],
    "additionalProperties": False,
    "properties": {
        "robot": _TEXT,
        "date": {"type": "string", "pattern": _DATE},
        "machine": _ITEM,
        "instrument": _ITEM,
        "temperature_C": {
            "type": "array",
            "items": {"type": "number"},
            "minItems": 2,
            "maxItems": 2,
            "description": "lowest and highest during the measurements",
        },
        "procedure": _TEXT,
        "signed_by": _TEXT,
        "place": _TEXT,
        "versions": {"type": "object", "additionalProperties": _TEXT},
        "calibration_sha256": {"type": "string", "pattern": "^[0-9a-f]{64}$"},
        "decision_rule": {"enum": ["simple", "guarded"]},
        "statements": {
            "type": "array",
            "items": {
                "type": "object",
                "required": ["name", "symbol", "value_m", "expanded_uncertainty_k2_m", "limit_m", "decision", "source"],
                "additionalProperties": False,
                "properties": {
                    "name": _TEXT,
                    "symbol": _TEXT,
                    "value_m": {"type": "number"},
                    "expanded_uncertainty_k2_m": _NUMBER_OR_NONE
                    | {"minimum": 0, "description": "null if it is not stated, or included in the value of a bound"},
                    "limit_m": _NUMBER_OR_NONE,
                    "decision": {"enum": ["conforms", "does not conform", "undecided", "no limit"]},
                    "source": _TEXT,
                },
            },
        },
        "not_claimed": {"type": "array", "items": _TEXT},
    },
}
"""JSON Schema of :attr:`Certificate.data`."""

_DAY = re.compile(r"\d{4}-\d\d-\d\d", re.ASCII)
_REQUIRED = ("date", "machine", "instrument", "temperature_C", "procedure", "signed_by")
_OPTIONAL = ("place", "limits_m", "decision_rule")
_BOUND = "bound of the tip error, corrected, at 95 % of the poses of the workspace, each with 95 % probability"
_BOUND_SYMBOL = "tip.bound_95"
_RMS = "tip error over the workspace, corrected, root mean square"
_ABSOLUTE_ZERO = -273.15  # [deg C]
_PACKAGES = ("pm3dof_pin", "pin", "numpy", "scipy")


@dataclass(frozen=True)
class Certificate:
    """A report to sign."""

    data: dict[str, Any]  #: everything, as :data:`SCHEMA` describes it

    @classmethod
    def make(cls, calibration: Path | str, about: Path | str, tests: Sequence[AcceptanceResult] = ()) -> Certificate:
        """Collect the statements of a calibration and of tests on the calibrated machine.

        Args:
            calibration: the folder of the calibration.
            about: YAML file: date, machine, instrument, temperature_C, procedure, signed_by; optional are place,
                decision_rule (guarded), and limits_m by symbol.
            tests: results of acceptance tests. Several of one kind need labels, which are then part of the symbols, as
                in `positioning.x.A` of a file x.json.

        Raises:
            InvalidValueError: several tests of one kind have the same label, or none.
            DescriptionError: a file is unreadable, an entry is missing or of another kind, or the folder was changed.
        """
        given = _about(Path(about))
        folder = Path(calibration)
        checksum = checksum_of(folder)
        try:
            summary = read_summary(folder)
            found = _of_calibration(summary)
        except (LookupError, TypeError, AttributeError) as error:
            raise DescriptionError(
                folder / "calibration.yaml", "contents", f"expected a summary ({error!r})"
            ) from error
        for (words, prefix), test in zip(_named(tests), tests, strict=True):
            source = "; ".join([f"{test.standard}, {test.readings} readings", *test.notes])
            for symbol, value in test.values.items():
                found.append((f"{words}, {symbol}", f"{prefix}.{symbol}", value, test.uncertainties[symbol], source))
        limits, rule = given.pop("limits_m", {}), given.pop("decision_rule", "guarded")
        if unknown := sorted(set(limits) - {symbol for _, symbol, *_ in found}):
            known = ", ".join(symbol for _, symbol, *_ in found)
            raise DescriptionError(
                about, "limits_m", f"expected symbols of statements, {known}; not {', '.join(unknown)}"
            )
        statements = [
            {
                "name": name,
                "symbol": symbol,
                "value_m": value,
                "expanded_uncertainty_k2_m": uncertainty,
                "limit_m": limits.get(symbol),
                "decision": _decision(value, uncertainty, limits.get(symbol), rule, is_bound=symbol == _BOUND_SYMBOL),
                "source": source,
            }
            for name, symbol, value, uncertainty, source in found
        ]
        versions = {name: entry for name in _PACKAGES if (entry := _version(name))}
        given |= {
            "robot": str(summary["robot"]),
            "versions": versions,
            "calibration_sha256": checksum,
            "decision_rule": rule,
        }
        return cls(given | {"statements": statements, "not_claimed": _not_claimed(summary, tests)})

    def as_html(self) -> str:
        """Return the report as a page with lines for a signature."""
        data = self.data
        rows = []
        for each in data["statements"]:
            limit = each["limit_m"]
            rows.append(
                [
                    each["name"],
                    f"{1e6 * each['value_m']:.1f}",
                    uncertainty_in_words(each),
                    "" if limit is None else f"{1e6 * limit:.1f}",
                    each["decision"],
                    each["source"],
                ]
            )
        items = [(kind, data[kind]) for kind in ("machine", "instrument")]
        described = [[kind, *(item.get(key, "") for key in _ITEM_KEYS)] for kind, item in items]
        low, high = data["temperature_C"]
        rule = {
            "simple": "A value conforms if it does not exceed its limit; its uncertainty is not regarded.",
            "guarded": "A value conforms if value + U does not exceed its limit; it does not if value - U exceeds it. "
            "Otherwise it is undecided (ISO 14253-1). A bound, which includes its uncertainty, conforms if it does not "
            "exceed its limit, and is otherwise undecided.",
        }[data["decision_rule"]]
        software = ", ".join(f"{name} {number}" for name, number in data["versions"].items())
        parts = [
            f"<h1>Calibration report: {escape(data['machine']['name'])}</h1>",
            f"<p>{escape(data['date'])}{', ' + escape(data['place']) if 'place' in data else ''}; "
            f"{low:g} to {high:g} °C</p>",
            html_table(["", "name", "serial number", "certificate", "calibrated until"], described),
            f"<h2>Procedure</h2><p>{escape(data['procedure'])}</p>",
            "<h2>Statements</h2><p>U is the expanded uncertainty, k = 2.</p>",
            html_table(["", "value [µm]", "U [µm]", "limit [µm]", "decision", "source"], rows),
            f"<p>Decision rule: {rule}</p>",
            "<h2>Not claimed</h2><ul>" + "".join(f"<li>{escape(text)}</li>" for text in data["not_claimed"]) + "</ul>",
            f"<p>Software: {escape(software)}. SHA-256 of the calibration: {data['calibration_sha256']}</p>",
            f"<p><br><br>______________________________<br>{escape(data['signed_by'])}</p>",
        ]
        return html_page(f"Calibration report: {data['machine']['name']}", parts)


def uncertainty_in_words(statement: Mapping[str, Any]) -> str:
    """Return the expanded uncertainty of one of the statements [µm], or that it is included or not stated."""
    uncertainty = statement["expanded_uncertainty_k2_m"]
    if uncertainty is None:
        return "included" if statement["symbol"] == _BOUND_SYMBOL else "not stated"
    return f"{1e6 * uncertainty:z.1f}"


def _named(tests: Sequence[AcceptanceResult]) -> list[tuple[str, str]]:
    """Return name and symbol of each test, with its label where there are several of its kind."""
    counts = Counter(test.test for test in tests)
    labels = [test.label if counts[test.test] > 1 else "" for test in tests]
    named = [
        (f"{test.test} test" + (f" {label}" if label else ""), test.test + (f".{label}" if label else ""))
        for test, label in zip(tests, labels, strict=True)
    ]
    if twice := [symbol for (_, symbol), count in Counter(named).items() if count > 1]:
        problem = f"has several named {', '.join(twice)}"
        raise InvalidValueError("tests", problem=problem, expected="files of different names, one for each")
    return named


def _about(path: Path) -> dict[str, Any]:
    """Read and check the YAML file."""
    data = read_mapping(path)
    if missing := [key for key in _REQUIRED if key not in data]:
        raise DescriptionError(path, "report", f"expected {', '.join(_REQUIRED)}; {', '.join(missing)} is missing")
    if unknown := [str(key) for key in data if key not in (*_REQUIRED, *_OPTIONAL)]:
        raise DescriptionError(
            path, "report", f"expected {', '.join((*_REQUIRED, *_OPTIONAL))}; not {', '.join(unknown)}"
        )
    data = {**data, "date": str(data["date"])}
    for key in ("date", "procedure", "signed_by", "place"):
        if key in data and not (isinstance(data[key], str) and data[key].strip()):
            raise DescriptionError(path, key, f"expected words, not {data[key]!r}")
    if not _is_day(data["date"]):
        raise DescriptionError(path, "date", f"expected YYYY-MM-DD, a day of the calendar, not {data['date']}")
    for kind in ("machine", "instrument"):
        item = data[kind]
        if not isinstance(item, dict) or not {"name", "serial_number"} <= set(item) <= set(_ITEM_KEYS):
            raise DescriptionError(path, kind, f"expected name and serial_number, of {', '.join(_ITEM_KEYS)}")
        for key, value in item.items():
            if not isinstance(value, (str, int, float, date)) or isinstance(value, bool) or not str(value).strip():
                raise DescriptionError(path, f"{kind}: {key}", f"expected words or a number, not {value!r}")
        data[kind] = {key: str(value) for key, value in item.items()}
        if (until := data[kind].get("calibrated_until")) is None:
            continue
        if not (_is_day(until) or _is_day(f"{until}-01")):
            raise DescriptionError(path, kind, f"expected calibrated_until YYYY-MM-DD or YYYY-MM, not {until}")
        if until < data["date"][: len(until)]:
            raise DescriptionError(path, kind, f"is calibrated until {until}, expected no day before {data['date']}")
    temperature = data["temperature_C"]
    if not (
        isinstance(temperature, list)
        and len(temperature) == len(("low", "high"))
        and all(map(is_finite_number, temperature))
    ):
        raise DescriptionError(path, "temperature_C", f"expected lowest and highest, not {temperature!r}")
    if not _ABSOLUTE_ZERO < temperature[0] <= temperature[1]:
        raise DescriptionError(path, "temperature_C", f"expected the lowest first, not {temperature!r}")
    limits = data.get("limits_m", {})
    if isinstance(limits, dict):
        data["limits_m"] = limits = {str(symbol): _number(value) for symbol, value in limits.items()}
    if not isinstance(limits, dict) or not all(is_finite_number(value) and value > 0.0 for value in limits.values()):
        raise DescriptionError(path, "limits_m", f"expected positive numbers of metres by symbol, not {limits!r}")
    if data.get("decision_rule", "guarded") not in ("simple", "guarded"):
        raise DescriptionError(path, "decision_rule", f"expected simple or guarded, not {data['decision_rule']!r}")
    return data


def _is_day(text: str) -> bool:
    with suppress(ValueError):
        return bool(_DAY.fullmatch(text) and date.fromisoformat(text))
    return False


def _number(value: object) -> object:
    """Return a number for words such as 100e-6, which YAML takes for a word without a decimal point."""
    try:
        return plain_number(value) if isinstance(value, str) else value
    except ValueError:
        return value


def _of_calibration(summary: Mapping[str, Any]) -> list[tuple[str, str, float, float | None, str]]:
    """Return name, symbol, value, uncertainty and source of what a calibration states."""
    found: list[tuple[str, str, float, float | None, str]] = []
    interval, bound = summary["tip_error_rms_95_percent_interval_m"], summary["tip_error_95_percent_bound_m"]
    if interval is not None:
        low, high = interval
        found.append((_RMS, "tip.rms", 0.5 * (low + high), 0.5 * (high - low), "calibration, 95 % interval"))
    if bound is not None:
        found.append((_BOUND, _BOUND_SYMBOL, bound, None, "calibration, uncertainty included"))
    if "validation" in summary:
        errors = summary["validation"]["tip_error_after_m"]
        count = summary["validation"]["poses"]
        found.append(
            (f"greatest tip error at {count} validation poses", "tip.validation_max", errors["max"], None, "validation")
        )
    return found


def _not_claimed(summary: Mapping[str, Any], tests: Sequence[AcceptanceResult]) -> list[str]:
    texts = [f"Not seen by the measurements: {summary['what_was_not_seen']}"] if summary["what_was_not_seen"] else []
    texts += [f"The calibration was written although {reason}" for reason in summary.get("forced_against", ())]
    texts.append(
        "Other temperatures, loads and speeds than those of the measurements; wear, and changes after this date."
    )
    texts.append("Statements hold for commands corrected by this calibration, within the workspace of the description.")
    if not tests:
        texts.append("No test of ISO 230 was made on the calibrated machine.")
    else:
        texts += [
            f"The {words} has {'; '.join(test.notes)}."
            for (words, _), test in zip(_named(tests), tests, strict=True)
            if test.notes
        ]
        texts.append(
            "Tests hold for the lines, circles and spheres that were measured; they are no statement on others."
        )
    return texts


def _decision(value: float, uncertainty: float | None, limit: float | None, rule: str, *, is_bound: bool) -> str:
    if limit is None:
        return "no limit"
    if rule == "simple" or (is_bound and value <= limit):
        return "conforms" if value <= limit else "does not conform"
    if uncertainty is None:
        return "undecided"
    if value + uncertainty <= limit:
        return "conforms"
    return "does not conform" if value - uncertainty > limit else "undecided"


def _version(name: str) -> str:
    try:
        return version(name.replace("_", "-"))
    except PackageNotFoundError:
        return ""
