"""A path in numbers: the worst point for each quantity with its line, the needs of the drives, feed ceilings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pm3dof_pin.kinematics.poses import REACH, limit_names
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.tolerances import SAME
from pm3dof_pin.typing import Array, Vector

# by key of the summary: the column, and whether its greatest value is the worst
_WORST = {
    "least_limit_margin": ("limit_margin", False),
    "least_singularity_distance": ("singularity_distance", False),
    "greatest_feed_m_s": ("feed_m_s", True),
    "least_feed_ceiling_m_s": ("feed_ceiling_m_s", False),
    "greatest_deflection_m": ("deflection_m", True),
    "least_stiffness_along_N_m": ("stiffness_along_N_m", False),
    "least_stiffness_across_N_m": ("stiffness_across_N_m", False),
    "greatest_expected_error_m": ("expected_error_m", True),
    "greatest_error_bound_m": ("error_bound_m", True),
    "greatest_error_95_percent_m": ("error_95_percent_m", True),
    "lowest_frequency_Hz": ("lowest_frequency_Hz", False),
}
_ROUNDING = 1e-9  # relative, of forces at their limits
_MOMENTS = ("speed", "acceleration", "force", "power")


class PathSummary:
    """What blocks of columns come to, block by block.

    Args:
        robot: the robot.
        lines: the line of each move.
        force_limits: of the drives, in the order of the commands, infinite where there are none [N, N m].
    """

    def __init__(self, robot: Robot, lines: NDArray[np.int64], force_limits: Vector) -> None:
        self._robot, self._lines, self._force_limits = robot, lines, force_limits
        self._first_beyond_force: int | None = None
        self._counts = dict.fromkeys(("points", "points_within_limits", "points_out_of_reach", "points_off_branch"), 0)
        self._counts["points_beyond_drive_force"] = 0
        self._first_broken: int | None = None
        self._broken = 0
        self._worst: dict[str, tuple[float, int]] = {}
        self._time, self._energy = 0.0, 0.0
        count = len(robot.commands)
        self._squares, self._driving, self._lasting = np.zeros(count), np.zeros(count), 0.0
        self._peaks: dict[str, list[tuple[float, int]]] = {name: [(math.nan, 0)] * count for name in _MOMENTS}
        self._of_line = np.unique(lines)
        self._ceilings = np.full(len(self._of_line), np.inf)

    def add(self, columns: Mapping[str, Array], lasting: Vector) -> None:
        """Add a block of points, each of which stands for a time, shape=(n,) [s]."""
        lines = columns["line"].astype(np.int64)
        within = columns["within_limits"] == 1.0
        flags = columns["broken_limits"].astype(np.int64)
        self._counts["points"] += len(lines)
        self._counts["points_within_limits"] += int(within.sum())
        self._counts["points_out_of_reach"] += int((flags & REACH > 0).sum())
        self._counts["points_off_branch"] += int((np.nan_to_num(columns["branch"]) != 0).sum())
        self._broken |= int(np.bitwise_or.reduce(flags, initial=0))
        if self._first_broken is None and not within.all():
            self._first_broken = int(lines[int(within.argmin())])
        known = dict(columns)
        if "deflection_x_m" in known:
            known["deflection_m"] = np.linalg.norm([known[f"deflection_{axis}_m"] for axis in "xyz"], axis=0)
        for key, (name, greatest) in _WORST.items():
            if name in known:
                self._keep(self._worst, key, known[name], lines, greatest=greatest)
        self._time, self._energy = float(columns["time_s"][-1]), float(columns["energy_J"][-1])
        self._add_drives(columns, lines, lasting)
        ceilings = np.nan_to_num(columns["feed_ceiling_m_s"], nan=np.inf)
        np.minimum.at(self._ceilings, np.searchsorted(self._of_line, lines), ceilings)

    def _add_drives(self, columns: Mapping[str, Array], lines: NDArray[np.int64], lasting: Vector) -> None:
        too_weak = np.zeros(len(lines), dtype=bool)
        for k in range(len(self._robot.commands)):
            found = {
                moment: next(values for key, values in columns.items() if key.startswith(f"u{k + 1}_{moment}_"))
                for moment in _MOMENTS
            }
            too_weak |= np.abs(np.nan_to_num(found["force"])) > self._force_limits[k] * (1.0 + _ROUNDING)
            force, weights = found["force"], np.where(np.isfinite(found["force"]), lasting, 0.0)
            self._squares[k] += np.sum(weights * np.nan_to_num(force) ** 2)
            self._driving[k] += np.sum(weights * np.maximum(np.nan_to_num(found["power"]), 0.0))
            self._lasting += float(weights.sum()) if k == 0 else 0.0
            for moment, values in found.items():
                kept = {"": self._peaks[moment][k]} if self._peaks[moment][k][1] else {}
                self._keep(kept, "", np.abs(values), lines, greatest=True)
                self._peaks[moment][k] = kept.get("", (math.nan, 0))
        self._counts["points_beyond_drive_force"] += int(too_weak.sum())
        if self._first_beyond_force is None and too_weak.any():
            self._first_beyond_force = int(lines[int(too_weak.argmax())])

    @staticmethod
    def _keep(
        worst: dict[str, tuple[float, int]], key: str, values: Vector, lines: NDArray[np.int64], *, greatest: bool
    ) -> None:
        signed = np.where(np.isfinite(values), values if greatest else -values, -np.inf)
        most = float(signed.max())
        if not np.isfinite(most):
            return
        row = int((signed >= most - SAME * abs(most)).argmax())  # of equals, as where two moves meet, the first
        before = -np.inf if key not in worst else worst[key][0] if greatest else -worst[key][0]
        if most > before + SAME * abs(most):
            worst[key] = (float(values[row]), int(lines[row]))

    def as_data(self) -> dict[str, Any]:
        """Return the summary as plain data; keys end in their unit."""
        robot = self._robot
        broken = [name for bit, name in enumerate(limit_names(robot)) if self._broken & (1 << bit)]
        counts = self._counts
        data: dict[str, Any] = {
            "robot": robot.name,
            **counts,
            "within_limits": counts["points"] == counts["points_within_limits"],
            "broken_limits": broken,
            "first_line_beyond_limits": self._first_broken,
            "first_line_beyond_drive_force": self._first_beyond_force,
            "time_s": self._time,
            "energy_J": self._energy,
        }
        data |= {key: value for key, (value, _) in self._worst.items()}
        data["lines"] = {key: line for key, (_, line) in self._worst.items()}
        data["drives"] = [self._drive(k) for k in range(len(robot.commands))]
        finite = np.isfinite(self._ceilings)
        data["feed_ceilings"] = {"line": self._of_line[finite], "feed_m_s": self._ceilings[finite]}
        return data

    def _drive(self, k: int) -> dict[str, Any]:
        command = self._robot.commands[k]
        linear = self._robot.single_joint(command.joint).translates
        unit = "N" if linear else "N_m"
        keys = {"speed": f"speed_{command.unit}_s", "acceleration": f"acceleration_{command.unit}_s2"}
        keys |= {"force": f"force_{unit}", "power": "power_W"}
        found: dict[str, Any] = {"drive": command.name}
        found[f"rms_force_{unit}"] = math.sqrt(self._squares[k] / self._lasting) if self._lasting else math.nan
        for moment, key in keys.items():
            value, line = self._peaks[moment][k]
            found |= {f"peak_{key}": value, f"peak_{moment}_line": line}
        effort = float(self._force_limits[k])
        found[f"effort_limit_{unit}"] = effort if math.isfinite(effort) else None
        found["driving_energy_J"] = float(self._driving[k])
        return found


WORST_HEADER = ("worst along the path", "", "", "line")
DRIVE_HEADER = ("drive", "rms force", "peak force", "", "peak speed", "", "peak acceleration", "", "peak power [W]")

_WORDS = {
    "least_limit_margin": ("limit margin, of the joint's range", 1.0, ""),
    "least_singularity_distance": ("distance to a singularity", 1.0, ""),
    "greatest_feed_m_s": ("feed", 6e4, "mm/min"),
    "least_feed_ceiling_m_s": ("least feed ceiling by the drives", 6e4, "mm/min"),
    "greatest_deflection_m": ("deflection", 1e6, "µm"),
    "least_stiffness_along_N_m": ("stiffness along the feed", 1e-6, "N/µm"),
    "least_stiffness_across_N_m": ("stiffness across the feed", 1e-6, "N/µm"),
    "greatest_expected_error_m": ("expected error, rms", 1e6, "µm"),
    "greatest_error_95_percent_m": ("error with 95 % probability", 1e6, "µm"),
    "greatest_error_bound_m": ("error, at most", 1e6, "µm"),
    "lowest_frequency_Hz": ("lowest natural frequency", 1.0, "Hz"),
}


def worst_rows(summary: Mapping[str, Any]) -> list[list[str]]:
    """Return rows of text about the worst points: what, value, unit, line."""
    return [
        [words, f"{factor * summary[key]:.4g}", unit, str(summary["lines"][key])]
        for key, (words, factor, unit) in _WORDS.items()
        if key in summary
    ]


def drive_rows(summary: Mapping[str, Any]) -> list[list[str]]:
    """Return rows of text about the drives, in the order of :data:`DRIVE_HEADER`."""
    rows = []
    for drive in summary["drives"]:
        force = "N_m" if "rms_force_N_m" in drive else "N"
        length = "m" if "peak_speed_m_s" in drive else "rad"
        numbers = [f"rms_force_{force}", f"peak_force_{force}", f"peak_speed_{length}_s"]
        texts = [f"{drive[key]:.4g}" for key in (*numbers, f"peak_acceleration_{length}_s2", "peak_power_W")]
        texts[2:2], texts[4:4], texts[6:6] = [force.replace("_", " ")], [f"{length}/s"], [f"{length}/s^2"]
        rows.append([drive["drive"], *texts])
    return rows
