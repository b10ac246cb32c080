"""A layout for Foxglove: plots of a recording, of two versions' predictions and errors, of issued
and applied commands, and the regions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

COLOURS = ("#111827", "#b34d08", "#0a6ba8")


def layout(plant: Mapping[str, Any], models: Sequence[str]) -> dict[str, Any]:
    """Returns the layout as JSON that Foxglove imports.

    `models` names the versions whose predictions the recording holds, such as `v1` and `v5`.
    """
    topics = plant.get("topics", {})
    observed, ordered = (
        topics.get("observation", "/joint_states"),
        topics.get("command", "/joint_commands"),
    )
    configured: dict[str, Any] = {}
    for at, channel in enumerate(plant["observations"]):
        path = _path(channel, "position" if at == 0 else "velocity")
        title = f"{channel['name']} [{channel['unit']}]"
        signals = [f"{observed}{path}", *(f"/trueup/{m}/prediction{path}" for m in models)]
        residuals = [f"/trueup/{m}/residual{path}" for m in models]
        configured[f"Plot!signal-{at}"] = _plot(title, signals, COLOURS)
        configured[f"Plot!residual-{at}"] = _plot(
            f"observed less predicted, {channel['name']}", residuals, COLOURS[1:]
        )
    for at, channel in enumerate(plant["commands"]):
        path = _path(channel, "effort")
        title = f"{channel['name']} [{channel['unit']}], issued and applied"
        both = [f"{ordered}{path}", f"/trueup/applied{path}"]
        configured[f"Plot!command-{at}"] = _plot(title, both, COLOURS)
    panels = list(configured)
    configured["RawMessages!regions"] = {"topicPath": "/trueup/regions", "diffEnabled": False}
    return {
        "configById": configured,
        "globalVariables": {},
        "userNodes": {},
        "layout": _stacked([*panels, "RawMessages!regions"]),
    }


def _path(channel: Mapping[str, Any], default: str) -> str:
    """The path of a channel in a JointState."""
    field, joint = channel.get("field") or default, channel.get("joint")
    return f'.{field}[:]{{name=="{joint}"}}' if joint else f".{field}[0]"


def _plot(title: str, paths: Sequence[str], colours: Sequence[str]) -> dict[str, Any]:
    return {
        "title": title,
        "paths": [_line(p, c) for p, c in zip(paths, colours, strict=False)],
        "showLegend": True,
        "isSynced": True,
        "xAxisVal": "timestamp",
    }


def _line(path: str, colour: str) -> dict[str, Any]:
    return {"value": path, "enabled": True, "timestampMethod": "receiveTime", "color": colour}


def _stacked(panels: Sequence[str]) -> Any:
    """Stacks panels one above the other, all of the same height."""
    if len(panels) == 1:
        return panels[0]
    return {
        "direction": "column",
        "first": panels[0],
        "second": _stacked(panels[1:]),
        "splitPercentage": 100.0 / len(panels),
    }
