"""Gates that tests declare on purpose, and that a service takes only because they say what they
are."""

from typing import Any

from trueup_client import Client, Problem

LENIENT: dict[str, Any] = {
    "schema": "trueup.gate/1",
    "rules": [{"rule": "one_step_no_worse", "slack": 1e9}],
    "scoring": {"horizon_s": 2.0, "windows": "first"},
    "vacuous": True,
    "because": "any candidate serves here",
}


def in_force(client: Client, plant: str, **other: Any) -> dict[str, Any]:
    """The lenient gate, with other fields if there are any, declared in the place of the one in
    force unless it is that one."""
    document = LENIENT | other
    try:
        before = client.gate_in_force(plant)
    except Problem:  # there is none yet
        return dict(client.declare_gate(plant, document))
    if {k: v for k, v in before["document"].items() if k in document} == document:
        return dict(before)
    return dict(client.declare_gate(plant, document | {"follows": before["digest"]}))
