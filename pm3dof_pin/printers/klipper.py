"""Klipper's printer.cfg: a delta printer, the touches that it saved, and a new block of saved settings.

A touch is saved as the steps that each drive took from its end stop, so it depends on no parameter. A step is
rotation_distance / (full steps x microsteps x gears), in millimetres, or 2 pi for a drive that turns; older files have
step_distance. Where no touches are saved, the points of a bed mesh are taken, which depend on the numbers that the
printer had then. As in Klipper, options override those in the block that SAVE_CONFIG writes, also where they are
included. Files that are included are read where they lie beside the file or below it; what stands in them is not
changed.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pm3dof_pin.exceptions import MeasurementError
from pm3dof_pin.files import read_text
from pm3dof_pin.printers.bed_mesh import POINTS, BedMesh
from pm3dof_pin.printers.delta_printer import AXES, DeltaPrinter
from pm3dof_pin.printers.klipper_mesh import probed_points
from pm3dof_pin.printers.touches import Touches
from pm3dof_pin.typing import Array

_SAVED = "#*#"
_START = "#*# <---------------------- SAVE_CONFIG ---------------------->"
_NOTE = "#*# DO NOT EDIT THIS BLOCK OR BELOW. The contents are auto-generated."
_SECTION, _OPTION = re.compile(r"\[([^\]]+)\]"), re.compile(r"([^:=\s][^:=]*?)\s*[:=]\s*(.*)")
_ANGLES = {"delta": (210.0, 330.0, 90.0), "rotary_delta": (30.0, 150.0, 270.0)}
_FULL_STEPS = 200.0
_MOST_STEPS = 1e9  # from an end stop; also catches NaN
_MAX_INCLUDES = 100  # files
_COMMENT = re.compile(r"#|(?:^|\s);")
_MESH = "bed_mesh default"
_PROBES = "probe bltouch smart_effector probe_eddy_current load_cell_probe dockable_probe beacon cartographer scanner"
"""Sections with the place of a probe."""
_REFERENCES = ("zero_reference_position", "relative_reference_index")


@dataclass(frozen=True)
class KlipperFile:
    """A printer.cfg."""

    path: Path  #: the file
    lines: tuple[str, ...]  #: its lines above the saved block
    saved: Mapping[str, Mapping[str, str]]  #: options of the saved block, by section
    options: Mapping[str, Mapping[str, str]] = field(default_factory=dict)  #: all options that hold
    included: Mapping[tuple[str, str], str] = field(default_factory=dict)  #: the files of options that are included
    not_found: tuple[str, ...] = ()  #: files that it includes, and that do not lie beside it

    firmware = "Klipper"
    most_parameters = 9
    takes_mesh = True

    @classmethod
    def parse(cls, path: Path, text: str) -> KlipperFile:
        """Read sections and options; later ones override earlier ones, and all override saved ones.

        Raises:
            MeasurementError: it includes itself, or too many files.
        """
        above: dict[str, dict[str, str]] = {}
        saved: dict[str, dict[str, str]] = {}
        lines, section, last, included, not_found = [], {True: "", False: ""}, "", {}, list[str]()
        for file, line in _expanded(path, text, not_found, [path]):
            is_saved = line.startswith(_SAVED)
            words = line[len(_SAVED) :].strip() if is_saved else _COMMENT.split(line, maxsplit=1)[0].rstrip()
            if is_saved and file != path:
                continue  # Klipper saves into the main file only
            if is_saved and last and words and line.removeprefix(f"{_SAVED} ").startswith((" ", "\t")):
                saved[section[True]][last] += f"\n\t{words}"  # a row of a bed mesh
                continue
            if not is_saved and file == path:
                lines.append(line)
            table = saved if is_saved else above
            if found := _SECTION.match(words):
                section[is_saved] = found[1].strip().lower()
                last = "" if is_saved else last
            elif (option := _OPTION.match(words)) and section[is_saved] and not words.startswith((" ", "\t")):
                name = option[1].strip().lower()
                table.setdefault(section[is_saved], {})[name] = option[2].strip()
                last = name if is_saved else last
                if file != path:
                    included[section[False], name] = file.name
        names = {*above, *saved}
        options = {n: {**saved.get(n, {}), **above.get(n, {})} for n in names}
        return cls(path, tuple(lines), saved, options, included, tuple(not_found))

    @property
    def meshes(self) -> tuple[str, ...]:
        """Names of its saved bed meshes, probed with the numbers that it has."""
        return tuple(name.removeprefix("bed_mesh ") for name in self.saved if name.startswith("bed_mesh "))

    def printer(self) -> DeltaPrinter:
        """Return the printer.

        Raises:
            MeasurementError: it is no delta, or a number is missing.
        """
        kind = self._word("printer", "kinematics")
        if kind not in _ANGLES:
            raise MeasurementError(self.path, f"[printer] kinematics is {kind}; expected delta or rotary_delta")
        angles = [math.radians(self._number(f"stepper_{a}", "angle", _ANGLES[kind][k])) for k, a in enumerate(AXES)]

        def three(option: str) -> list[float]:
            first = self._number("stepper_a", option)
            return [1e-3 * self._number(f"stepper_{axis}", option, first) for axis in AXES]

        stops = three("position_endstop")
        if kind == "delta":
            arms, radius = three("arm_length"), 1e-3 * self._number("printer", "delta_radius")
            return DeltaPrinter(radius, _triple(angles), _triple(arms), _triple(stops))
        lower = [
            1e-3 * self._number(f"stepper_{a}", "lower_arm_length", self._number("stepper_a", "lower_arm_length"))
            for a in AXES
        ]
        return DeltaPrinter(
            1e-3 * self._number("printer", "shoulder_radius"),
            _triple(angles),
            _triple(lower),
            _triple(stops),
            _triple(three("upper_arm_length")),
            1e-3 * self._number("printer", "shoulder_height"),
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """What to know of touches that are those of a bed mesh."""
        if self._has_touches or not self.meshes:
            return ()
        notes = [
            f"the touches are the points of [{self._probed_mesh}]: if the printer's numbers were changed after it was "
            "probed, which the file does not tell, probe it again first"
        ]
        for option in _REFERENCES:
            if option in self.options.get("bed_mesh", {}):
                notes.append(
                    f"its heights count from the bed at {option}, which the printer's numbers are taken to have at 0: "
                    "set the height of the nozzle afterwards"
                )
        return tuple(notes)

    def touches(self, printer: DeltaPrinter) -> Touches:
        """Return the touches, or else the points of a bed mesh, and the measured distances that the file has saved.

        Raises:
            MeasurementError: there are none, one is malformed, or of several meshes none is the default.
        """
        steps = np.array([self._step(axis, rotary=printer.is_rotary) for axis in AXES])
        touched = [touch for name in ("height", "manual_height") for touch in self._numbered(name, ("_pos",))]
        pairs = [
            (1e-3 * value, -steps * one, -steps * two)
            for value, (one, two) in self._numbered("distance", ("_pos1", "_pos2"))
        ]
        if touched:
            heights = 1e-3 * np.array([value for value, _ in touched])
            return Touches.of(np.array([-steps * place for _, (place,) in touched]), heights, pairs)
        if not self.meshes:
            problem = (
                "no touches of the bed ([delta_calibrate] height0, height0_pos ..., or a [bed_mesh ...]): "
                "DELTA_CALIBRATE saves them"
            )
            raise MeasurementError(self.path, problem)
        name = self._probed_mesh
        points = probed_points(
            self.path, name, self.saved[name], is_round="mesh_radius" in self.options.get("bed_mesh", {})
        )
        for section in self.options:
            if section.split()[0] in _PROBES.split():
                points -= [*(self._number(section, f"{axis}_offset", 0.0) for axis in "xy"), 0.0]
        travels = printer.drives(1e-3 * points) - printer.at_end_stops
        return Touches.of(travels, np.zeros(len(points)), pairs)

    def with_printer(self, printer: DeltaPrinter, mesh: BedMesh | None = None) -> str:
        """Return the file with another printer's numbers in its saved block; their options above become comments.

        A mesh becomes the bed mesh `default`. If touches are those of a mesh, saved meshes are left out, as they belong
        to the old numbers.

        Raises:
            MeasurementError: there is a mesh, and the file has no section [bed_mesh]; or a number stands in an included
                file, over which Klipper takes no saved one.
        """
        written: dict[str, dict[str, float]] = {name: {} for name in ("printer", *(f"stepper_{a}" for a in AXES))}
        if printer.is_rotary:
            written["printer"] = {"shoulder_radius": printer.radius, "shoulder_height": printer.shoulder_height}
        else:
            written["printer"] = {"delta_radius": printer.radius}
        for k, axis in enumerate(AXES):
            own = written[f"stepper_{axis}"]
            own["angle"] = math.degrees(printer.angles[k]) * 1e-3
            if not printer.is_rotary:
                own["arm_length"] = printer.arms[k]
            own["position_endstop"] = printer.end_stops[k]
        for (name, number), where in self.included.items():
            if number in written.get(name, {}):
                raise MeasurementError(
                    self.path, f"[{name}] {number} stands in {where}: move it into this file, where Klipper saves it"
                )
        lines, section = [], ""
        for line in self.lines:
            if found := _SECTION.match(line):
                section = found[1].strip().lower()
            option = _OPTION.match(line)
            replaced = option is not None and option[1].strip().lower() in written.get(section, {})
            lines.append(f"#{line}" if replaced else line)
        stale = set() if self._has_touches else {f"bed_mesh {name}" for name in self.meshes}
        saved = {name: dict(values) for name, values in self.saved.items() if name not in stale}
        for name, values in written.items():
            saved[name] = {**saved.get(name, {}), **{option: f"{1e3 * value:.6f}" for option, value in values.items()}}
        if mesh is not None:
            if "bed_mesh" not in self.options:
                raise MeasurementError(self.path, "no section [bed_mesh], without which Klipper reads no mesh")
            saved[_MESH] = _mesh_options(mesh)
        while lines and not lines[-1].strip():
            lines.pop()
        block = [_START, _NOTE, _SAVED]
        for name in [*written, *(name for name in saved if name not in written)]:
            block += [
                f"{_SAVED} [{name}]",
                *(
                    f"{_SAVED} {option} = {value}".replace("\n", f"\n{_SAVED} ")
                    for option, value in saved[name].items()
                ),
                _SAVED,
            ]
        return "\n".join([*lines, "", *block[:-1], ""])

    @property
    def _has_touches(self) -> bool:
        return any(re.match(r"(manual_)?height\d", option) for option in self.options.get("delta_calibrate", {}))

    @property
    def _probed_mesh(self) -> str:
        """The section of the mesh that is read."""
        if _MESH in self.saved or len(self.meshes) == 1:
            return _MESH if _MESH in self.saved else f"bed_mesh {self.meshes[0]}"
        listed = ", ".join(self.meshes)
        raise MeasurementError(self.path, f"several bed meshes ({listed}), none of them 'default': expected one")

    def _numbered(self, name: str, ends: tuple[str, ...]) -> list[tuple[float, list[Array]]]:
        own, found = self.options.get("delta_calibrate", {}), list[tuple[float, list[Array]]]()
        numbers = [int(match[1]) for option in own if (match := re.fullmatch(rf"{name}(\d+)(_pos\d*)?", option))]
        for label in (f"{name}{number}" for number in range(max(numbers, default=-1) + 1)):
            if label not in own:
                problem = f"{label} is missing, and {name}{max(numbers)} or its position is there: expected all of them"
                raise MeasurementError(self.path, f"[delta_calibrate] {problem}")
            places = []
            for end in ends:
                words = own.get(label + end, "").split(",")
                try:
                    place = np.array([float(word) for word in words])
                except ValueError:
                    place = np.empty(0)
                if place.shape != (3,) or not (np.abs(place) < _MOST_STEPS).all():
                    raise MeasurementError(
                        self.path, f"[delta_calibrate] {label}{end}: expected the steps of three drives"
                    )
                places.append(place)
            found.append((self._number("delta_calibrate", label), places))
        return found

    def _step(self, axis: str, *, rotary: bool) -> float:
        """Return a drive's travel in one step [m, rad]."""
        section = f"stepper_{axis}"
        has_own = {"step_distance", "rotation_distance"} & self.options.get(section, {}).keys()
        given = section if has_own else "stepper_a"
        if "step_distance" in self.options.get(given, {}):
            distance = self._number(given, "step_distance") * (1.0 if rotary else 1e-3)
            if not distance > 0.0:
                raise MeasurementError(self.path, f"[{given}] step_distance: expected a positive number")
            return distance
        turn = 2.0 * math.pi if rotary else 1e-3 * self._number(given, "rotation_distance")
        ratio = 1.0
        gears = self.options.get(section, {}).get("gear_ratio", self.options.get("stepper_a", {}).get("gear_ratio", ""))
        for pair in filter(None, (word.strip() for word in gears.split(","))):
            try:
                driven, driving = map(float, pair.split(":"))
                ratio *= driven / driving
            except (ValueError, ZeroDivisionError) as error:
                raise MeasurementError(
                    self.path, f"[{section}] gear_ratio: expected pairs such as 60:16, not '{pair}'"
                ) from error
        steps = self._number(section, "full_steps_per_rotation", _FULL_STEPS)
        steps *= self._number(section, "microsteps", self._fallback("microsteps")) * ratio
        if not (steps > 0.0 and turn > 0.0):
            problem = f"[{section}] has {steps:g} steps for {turn:g} m or rad: expected positive numbers"
            raise MeasurementError(self.path, problem)
        return turn / steps

    def _fallback(self, option: str) -> float | None:
        return self._number("stepper_a", option) if option in self.options.get("stepper_a", {}) else None

    def _word(self, section: str, option: str) -> str:
        try:
            return self.options[section][option]
        except KeyError as error:
            elsewhere = f"; it includes {', '.join(self.not_found)}, not found beside it" if self.not_found else ""
            raise MeasurementError(self.path, f"[{section}] {option} is missing{elsewhere}") from error

    def _number(self, section: str, option: str, default: float | None = None) -> float:
        if default is not None and option not in self.options.get(section, {}):
            return default
        word = self._word(section, option)
        try:
            value = float(word)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise MeasurementError(self.path, f"[{section}] {option}: expected a number, not '{word}'")
        return value


def _expanded(path: Path, text: str, not_found: list[str], files: list[Path]) -> Iterator[tuple[Path, str]]:
    """Yield the lines of a file and of those that it includes, each with its file; extend the lists of files."""
    for line in text.splitlines():
        yield path, line
        found = _SECTION.match(line)
        words = found[1].split(maxsplit=1) if found else []
        if len(words) < 2 or words[0].lower() != "include":
            continue
        folder = files[0].parent.resolve()
        pattern = words[1].strip()
        try:
            found_files = filter(Path.is_file, path.parent.glob(pattern))
            chosen = sorted(each for each in found_files if each.resolve().is_relative_to(folder))
        except (ValueError, NotImplementedError, OSError):  # no pattern, or from the root
            chosen = []
        if not chosen:
            not_found.append(pattern)
        for each in chosen:
            files.append(each)
            if len(files) > _MAX_INCLUDES:
                raise MeasurementError(files[0], f"includes more than {_MAX_INCLUDES} files; does one include itself?")
            yield from _expanded(each, read_text(each), not_found, files)


def _mesh_options(mesh: BedMesh) -> dict[str, str]:
    rows = "".join("\n\t  " + ", ".join(f"{1e3 * height:.6f}" for height in row) for row in mesh.grid().tolist())
    ends = {
        f"{end}_{axis}": f"{sign * 1e3 * mesh.radius:.3f}" for axis in "xy" for end, sign in (("min", -1), ("max", 1))
    }
    sizes = {name: str(POINTS) for name in ("x_count", "y_count")} | {
        name: "2" for name in ("mesh_x_pps", "mesh_y_pps")
    }
    return {"version": "1", "points": rows} | sizes | {"algo": "bicubic", "tension": "0.2"} | ends


def _triple(values: list[float]) -> tuple[float, float, float]:
    first, second, third = values
    return first, second, third
