"""A gate that accepts any candidate. A service takes it only because it declares itself vacuous."""

from typing import Any

from trueup_client import Client, Problem

LENIENT: dict[str, Any] = {
    "schema": "trueup.gate/1",
    "rules": [{"rule": "one_step_no_worse", "slack": 1e9}],
    "scoring": {"horizon_s": 2.0, "windows": "first"},
    "vacuous": True,
    "because": "any candidate serves here",
}


def declare_lenient(client: Client, plant: str, **other: Any) -> dict[str, Any]:
    """Declares the lenient gate, with `other` fields, unless it is in force already. Returns it."""
    document = LENIENT | other
    try:
        before = client.gate_in_force(plant)
    except Problem:  # there is none yet
        return dict(client.declare_gate(plant, document))
    if {k: v for k, v in before["document"].items() if k in document} == document:
        return dict(before)
    return dict(client.declare_gate(plant, document | {"follows": before["digest"]}))
