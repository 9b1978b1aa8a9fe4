"""JSON Schemas of the YAML files, for editors: made from what checks the files when they are read."""

from __future__ import annotations

from enum import StrEnum
from typing import Any

FileKind = StrEnum("FileKind", {"CLOSURES": "closures", "ERRORS": "errors", "PARAMETERS": "parameters"})
"""The YAML files of a robot."""


def file_schema(kind: FileKind) -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of a kind of file."""
    import msgspec

    from pm3dof_pin.description.closures import ClosuresSchema
    from pm3dof_pin.description.error_file import ErrorFileSchema
    from pm3dof_pin.description.parameters import ParameterSchema
    from pm3dof_pin.elastic.springs import SPRING_SCHEMAS

    schema: type | None = {FileKind.CLOSURES: ClosuresSchema, FileKind.ERRORS: ErrorFileSchema}.get(kind)
    wanted = [schema or ParameterSchema, *(SPRING_SCHEMAS.values() if kind is FileKind.CLOSURES else ())]
    (root, *springs), parts = msgspec.json.schema_components(wanted, ref_template="#/$defs/{name}")
    if kind is FileKind.PARAMETERS:  # a file of the tripod: a name and other texts, and sections of parameters
        section = {"if": {"type": "object"}, "then": {"additionalProperties": root}}
        root = {"type": "object", "properties": {"name": {"type": "string"}}, "additionalProperties": section}
    if springs:
        parts["ClosuresSchema"]["properties"]["springs"] = {"type": "array", "items": {"oneOf": springs}}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": kind.value, **root, "$defs": parts}
