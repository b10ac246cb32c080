"""Gates of tests: one that asks for an improvement, and one that accepts any candidate, which a
service takes only because it declares itself vacuous."""

from typing import Any

from trueup_client import Client, Problem

LENIENT: dict[str, Any] = {
    "schema": "trueup.gate/1",
    "rules": [{"rule": "one_step_no_worse", "slack": 1e9}],
    "scoring": {"horizon_s": 2.0, "windows": "first"},
    "vacuous": True,
    "because": "any candidate serves here",
}


# asks for what the default gate asks, on a recording that many plants of the tests share
IMPROVING: dict[str, Any] = {
    "schema": "trueup.gate/1",
    "rules": [
        {"rule": "rollout_improves", "ratio": 0.98},
        {"rule": "one_step_no_worse", "slack": 1.0},
    ],
    "scoring": {"horizon_s": 2.0, "windows": "first"},
    "held_out_uses": 1_000_000,
}


def declare_lenient(client: Client, plant: str, **other: Any) -> dict[str, Any]:
    """Declares the lenient gate, with `other` fields, unless it is in force already. Returns it."""
    return declare_following(client, plant, LENIENT | other)


def declare_following(client: Client, plant: str, document: dict[str, Any]) -> dict[str, Any]:
    """Declares a gate, behind the one in force where there is one, unless it is that already.
    Returns it."""
    try:
        before = client.gate_in_force(plant)
    except Problem:  # there is none yet
        return dict(client.declare_gate(plant, document))
    if {k: v for k, v in before["document"].items() if k in document} == document:
        return dict(before)
    follows = {"follows": before["digest"], "because": "a test asks for something else"}
    return dict(client.declare_gate(plant, follows | document))
