"""The digits that the chapter prints, to compare a run with. Nothing is computed from them."""

from __future__ import annotations

from collections.abc import Mapping

Digits = Mapping[str, Mapping[str, str]]

_NONE = dict.fromkeys(("nominal", "blind", "conditioned", "residual"), "0.000")

PUBLISHED: Mapping[str, Digits] = {
    "Training plants": {
        "transitions": {"pooled": "3840"},
        "k": {"low": "0.69", "high": "1.57"},
        "c": {"low": "0.21", "high": "0.74"},
        "b": {"low": "0.73", "high": "1.28"},
    },
    "Membership": {
        "deployment": {"family box": "True", "sample box": "True"},
        "shifted": {"family box": "False", "sample box": "False"},
        "(0.65, 0.5, 1.0)": {"family box": "True", "sample box": "False"},
    },
    "Identification": {"deployment": {"k": "1.250", "c": "0.620", "b": "0.820", "rank": "3"}},
    "Tracking error": {
        "nominal plant": {
            "nominal": "0.01459",
            "blind": "0.01607",
            "conditioned": "0.01756",
            "residual": "0.01756",
        },
        "deployment plant": {
            "nominal": "0.02134",
            "blind": "0.02134",
            "conditioned": "0.02558",
            "residual": "0.02558",
        },
        "deployment + sensor delay of 3": {
            "nominal": "0.01564",
            "blind": "0.01568",
            "conditioned": "0.01672",
            "residual": "0.01672",
        },
        "deployment + u_max 0.5": {
            "nominal": "0.03752",
            "blind": "0.03705",
            "conditioned": "0.03870",
            "residual": "0.03870",
        },
    },
    "Envelope breaches": dict.fromkeys(
        (
            "nominal plant",
            "deployment plant",
            "deployment + sensor delay of 3",
            "deployment + u_max 0.5",
        ),
        _NONE,
    ),
    "Open loop": {
        "nominal": {"1": "0.0032", "10": "0.0233", "50": "0.1542", "200": "0.3498"},
        "blind": {"1": "0.0031", "10": "0.0277", "50": "0.1487", "200": "0.3698"},
        "conditioned": {"1": "0.0000", "10": "0.0000", "50": "0.0000", "200": "0.0000"},
        "residual": {"1": "0.0000", "10": "0.0000", "50": "0.0000", "200": "0.0000"},
    },
    "Monitor": {
        "quantile 0.99": {
            "threshold": "0.00000",
            "held-out exceedance": "0.0000",
            "shifted exceedance": "1.0000",
            "first run starts at": "0",
            "alarm declared at": "2",
        },
    },
    "Gate": {
        "nominal": {"one-step": "0.00202", "rollout mean": "0.10825", "decision": "baseline"},
        "A": {"one-step": "0.00000", "rollout mean": "0.00000", "decision": "accept"},
        "B": {"one-step": "0.00427", "rollout mean": "0.09853", "decision": "reject"},
    },
    "Watchdog": {
        "sensor stops at tick 200": {
            "first trip [s]": "2.08",
            "forced commands": "192",
            "peak age [s]": "2.040",
        }
    },
}


def printed_like(value: float | int | str | bool, digits: str) -> str:
    """The value with as many decimals as the printed digits have."""
    if isinstance(value, bool | str):
        return str(value)
    return f"{value:.{len(digits.partition('.')[2])}f}"
