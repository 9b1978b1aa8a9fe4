"""`pm3dof recheck`."""

from __future__ import annotations

import hashlib
import math
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from pm3dof_pin.calibration.folder import HISTORY, read_compensation
from pm3dof_pin.calibration.recheck import add_to_history, read_history
from pm3dof_pin.calibration.recheck import recheck as compute
from pm3dof_pin.calibration.updating import updated
from pm3dof_pin.cli.options import ColumnsOf, Json
from pm3dof_pin.cli.output import message, print_result, table_lines
from pm3dof_pin.files import read_bytes, read_text, write_text_atomically
from pm3dof_pin.measuring.measurement_file import read_measurements


def recheck(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="New measurements (CSV), five to ten poses.")],
    calibration: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the calibration (method with lm).")],
    columns: ColumnsOf = None,
    own_frame: Annotated[
        bool, typer.Option("--own-frame", help="Positions are in the instrument's own frame; locate the base first.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Calibrate again from all rows, old and new, into this folder."),
    ] = None,
    record: Annotated[
        bool, typer.Option("--record/--no-record", help="Add the result to the history in the calibration's folder.")
    ] = True,
    as_json: Json = False,
) -> None:
    """Say from a few new rows whether a calibration still holds: unchanged, re-zero, or recalibrate; lengths in metres.

    The calibration is the prior, with its covariance; its checksums are compared first.
    """
    known = read_compensation(calibration)
    robot = known.errors.robot
    measurements = read_measurements(file, robot, own_frame=own_frame, columns=columns)
    found = compute(known, measurements)
    result = {"robot": robot.name} | found.as_data()
    earlier = read_history(calibration)
    units = [command.unit for command in robot.commands]
    rows = [
        [f"u{k}", *(f"{1e6 * value:z.1f}" for value in values), "µm" if unit == "m" else "µrad"]
        for k, (*values, unit) in enumerate(
            zip(found.zeros, found.zero_sigmas, found.detectable, units, strict=True), start=1
        )
    ]
    chances = ", ".join(f"{verdict} {100.0 * chance:z.1f} %" for verdict, chance in found.probabilities.items())
    kept, zeroed = (1e6 * value for value in (found.off_if_kept, found.off_if_zeroed))
    lines = [
        f"{found.verdict} ({chances}), from {found.rows} rows",
        *(
            [f"chance explains residuals as large with {100.0 * found.risk:.2g} % if the most probable were true"]
            if found.is_forced
            else []
        ),
        f"tip error on top of what the calibration states, rms: {kept:.1f} µm as it is, {zeroed:.1f} µm with new zeros",
        "",
        *table_lines(["drive", "place minus reading", "sigma", "shown with 95 %", ""], rows),
        _parts_in_words(found.detectable_parts),
        *([f"{len(earlier)} earlier checks, the last: {earlier[-1].get('verdict')}"] if earlier else []),
    ]
    print_result(result, lines, as_json=as_json)
    if record:
        entry = {"time": datetime.now(UTC).isoformat(timespec="seconds"), "measurements": file.name}
        entry |= {"measurements_sha256": hashlib.sha256(read_bytes(file)).hexdigest()}
        message(f"wrote {add_to_history(calibration, entry | found.as_data())}")
    if out is not None:
        again, _ = updated(calibration, measurements, found)
        folder = again.save(out)
        if (calibration / HISTORY).is_file() and out.resolve() != calibration.resolve():
            write_text_atomically(folder / HISTORY, read_text(calibration / HISTORY))
        message(f"wrote {folder}, from {len(again.measurements)} rows")


def _parts_in_words(detectable: float) -> str:
    if not math.isfinite(detectable):
        return "one moved part would not be told surely from moved zeros by these rows"
    size = f"{1e6 * detectable:.0f} µm, rms, of the tip beyond new zeros"
    return f"one moved part is called recalibrate with 95 % from {size} on; a lesser one may be missed"
