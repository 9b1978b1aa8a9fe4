"""What was understood of a file of measurements, before anything is fitted."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pm3dof_pin.errors.pose_error import TIP_LENGTH
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.export_file import ColumnMap, Export
from pm3dof_pin.measuring.instruments.table import datum_kinds
from pm3dof_pin.measuring.joint_columns import command_columns, drive_names
from pm3dof_pin.measuring.measurement_file import read_measurements
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.measuring.nuisances import Nuisances
from pm3dof_pin.typing import Mask


@dataclass(frozen=True, eq=False)
class FileCheck:
    """A file's form, its columns, and the measurements that it holds."""

    export: Export  #: the form: encoding, separator, header
    measurements: Measurements  #: the content, with warnings
    #: of each column its heading, least and greatest number [m, rad, s], and number of empty cells
    ranges: dict[str, tuple[str, float, float, int]]
    estimated: tuple[str, ...]  #: kinds of unknowns besides the machine's parameters
    misfit: float  #: median tip-weighted distance from the described machine [m]; NaN if no row shows the tool

    @classmethod
    def read(
        cls, path: Path | str, robot: Robot, *, own_frame: bool = False, columns: ColumnMap | None = None
    ) -> FileCheck:
        """Read a file as a calibration would.

        Raises:
            MeasurementError: the file cannot be understood, or cannot be true of the robot.
        """
        export = Export.read(Path(path), command_columns(robot), columns, drive_names(robot))
        table = export.table(command_columns(robot))
        seen = read_measurements(path, robot, own_frame=own_frame, columns=columns)
        ranges = {}
        for (name, values), written in zip(table.columns.items(), table.written, strict=True):
            finite = values[np.isfinite(values)]
            ends = (float(finite.min()), float(finite.max())) if finite.size else (np.nan, np.nan)
            ranges[name] = (export.headings[written], *ends, int(np.isnan(values).sum()))
        drives = tuple(command.unit for command in robot.commands)
        kinds = dict.fromkeys(part.kind for part in Nuisances.from_measurements(seen, drives).parts)
        shown = seen.seen[:, : seen.tool_columns].any(axis=1)
        misfits = seen.tip_misfits(robot.forward(seen.commands), TIP_LENGTH)[shown]
        return cls(export, seen, ranges, tuple(kinds), float(np.median(misfits)) if misfits.size else float("nan"))

    def counts(self) -> dict[str, int]:
        """Return the number of rows of each kind, those without any left out."""
        found, seen = self.measurements, self.measurements.seen
        tool = seen[:, : found.tool_columns]
        tool = tool & ~found.on_datums[:, None]
        distance = np.zeros(len(found), dtype=bool) if found.distances is None else np.isfinite(found.distances)
        position = tool[:, :3].all(axis=1)
        turned = tool[:, 3:].any(axis=1)
        begun = np.zeros(len(found), dtype=bool) if found.partners is None else found.partners >= 0
        none = np.zeros(len(found), dtype=bool)

        def rows_on(kind: str) -> Mask:
            return np.asarray(np.any([none, *(each.rows for each in found.datums if each.kind.name == kind)], axis=0))

        kinds = {
            "poses": position & turned,
            "positions": position & ~turned,
            "orientations": ~tool[:, :3].any(axis=1) & turned,
            "single coordinates": tool[:, :3].any(axis=1) & ~position & ~distance,
            "distances from fixed points": distance & ~begun,
            "distances between two commands": distance & begun,
            **{f"rows of a {kind}": rows_on(kind) for kind in datum_kinds()},
            "encoder readings": seen[:, found.tool_columns :].any(axis=1),
        }
        return {kind: int(rows.sum()) for kind, rows in kinds.items() if rows.any()}

    def as_data(self) -> dict[str, Any]:
        """Return everything as plain data; keys end in their unit."""
        export, found = self.export, self.measurements
        columns = {
            name: {"heading": heading, "least": low, "greatest": high, "empty_cells": empty}
            for name, (heading, low, high, empty) in self.ranges.items()
        }
        return {
            "file": str(export.path),
            "encoding": export.encoding,
            "separator": export.separator,
            "decimal": export.decimal,
            "header_line": export.header_line,
            "rows": export.rows,
            "columns": columns,
            "columns_of_words": sorted(export.words),
            "rows_by_kind": self.counts(),
            "different_commands": len(np.unique(found.pose_numbers[found.seen.any(axis=1)])),
            "visits": len(found.visits),
            "estimated_beside_the_machine": list(self.estimated),
            "median_distance_from_description_m": None if np.isnan(self.misfit) else self.misfit,
            "warnings": list(found.warnings),
        }
