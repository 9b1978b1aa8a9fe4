"""`pm3dof certificate`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from pm3dof_pin.calibration.acceptance import AcceptanceResult
from pm3dof_pin.calibration.certificate import SCHEMA, Certificate, uncertainty_in_words
from pm3dof_pin.cli.options import Json
from pm3dof_pin.cli.output import print_result, table_lines
from pm3dof_pin.files import write_text_atomically


def certificate(
    calibration: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the calibration.")],
    about: Annotated[
        Path, typer.Option(metavar="FILE", help="Machine, instrument, date, temperature, procedure, limits (YAML).")
    ],
    test: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE", help="Results of `acceptance evaluate` (JSON); may be repeated."),
    ] = None,
    out: Annotated[Path, typer.Option(help="Output folder: report (HTML, JSON) and its schema.")] = Path("results"),
    as_json: Json = False,
) -> None:
    """Write a report to sign: statements with expanded uncertainty and decision, and what is not claimed."""
    found = Certificate.make(calibration, about, [AcceptanceResult.read(path) for path in test or ()])
    texts = {
        "certificate.html": found.as_html(),
        "certificate.json": json.dumps(found.data, indent=2, ensure_ascii=False) + "\n",
        "certificate.schema.json": json.dumps(SCHEMA, indent=2) + "\n",
    }
    files = [write_text_atomically(out / name, text) for name, text in texts.items()]
    rows = []
    for each in found.data["statements"]:
        rows.append([each["symbol"], f"{1e6 * each['value_m']:z.1f}", uncertainty_in_words(each), each["decision"]])
    lines = table_lines(["statement", "[µm]", "U, k = 2", "decision"], rows)
    print_result(
        found.data,
        [*lines, "", *(f"not claimed: {text}" for text in found.data["not_claimed"])],
        as_json=as_json,
        files=files,
    )
