"""Write client/trueup_client/records.py from the service's OpenAPI document on standard input.

Run it, then `ruff format client`.
"""

import json
import sys
import textwrap
from pathlib import Path

MADE = Path(__file__).parent.parent / "client" / "trueup_client" / "records.py"
RECORDS = (
    "Plant", "Episode", "EpisodeContext", "Artifact", "Gate", "LooserThan", "GateInLine",
    "Output", "Job", "QueuedJob", "JobWithReads", "Decision", "Approval", "Evidence",
    "Channel",
    "ChannelPosition", "Policy", "Monitor", "Watch", "Alarm", "MonitorState", "Project", "Token",
    "IssuedToken", "Webhook", "DeclaredWebhook", "Label", "Identity",
    "AuditEntry",
    "Envelope",
)  # fmt: skip
PLAIN = {
    "string": "str",
    "integer": "int",
    "number": "float",
    "boolean": "bool",
    "object": "Document",
    "null": "None",
}
HEAD = '''"""The service's answers as types. Made by tools/make_records.py from its OpenAPI."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypedDict

Document = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Serving:
    """Which artifact answers for a plant. `generation` only grows; `since` is UTC, ISO 8601."""

'''


def module(document):
    """Returns the text of the module, before formatting."""
    schemas = document["components"]["schemas"]
    fields = [
        f"    {name}: {kind(schema)}" for name, schema in schemas["Serving"]["properties"].items()
    ]
    return HEAD + "\n".join(fields) + "\n" + "".join(record(name, schemas) for name in RECORDS)


def record(name, schemas):
    """Returns one record as a class, of which another record is the base if this one extends it."""
    schema = schemas[name]
    description = schema.get("description") or f"{name}, as the service keeps it."
    docstring = textwrap.fill(" ".join(description.split()), 90)
    docstring = docstring.replace("\n", "\n    ") + ("\n    " if "\n" in docstring else "")
    extended = next((r for r in RECORDS if extends(name, r, schemas)), None)
    base = {} if extended is None else schemas[extended]["properties"]
    fields = [
        f"    {key}: {kind(value)}"
        for key, value in schema["properties"].items()
        if key not in base
    ]
    of = extended or "TypedDict"
    return f'\n\nclass {name}({of}):\n    """{docstring}"""\n\n' + "\n".join(fields) + "\n"


def extends(name, other, schemas):
    """Returns whether a record is another one with more fields, as their names say."""
    named = name != other and (name.endswith(other) or name.startswith(other))
    return named and schemas[other]["properties"].items() <= schemas[name]["properties"].items()


def kind(schema):
    """Returns the Python type of a field."""
    if "anyOf" in schema:
        return " | ".join(dict.fromkeys(kind(one) for one in schema["anyOf"]))
    if "$ref" in schema:
        named = schema["$ref"].rpartition("/")[2]
        return named if named in RECORDS or named == "Serving" else "str"
    if schema.get("type") == "array":
        items = kind(schema.get("items", {"type": "object"}))
        return f"list[{'Document' if items == 'Serving' else items}]"
    return PLAIN[schema["type"]] if "type" in schema else "Any"


if __name__ == "__main__":
    MADE.write_text(module(json.load(sys.stdin)))
