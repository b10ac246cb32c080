"""A layout for Foxglove: plots of a recording, of two versions' predictions and errors, and the
regions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

COLOURS = ("#111827", "#b34d08", "#0a6ba8")


def layout(plant: Mapping[str, Any], models: Sequence[str]) -> dict[str, Any]:
    """Returns the layout as JSON that Foxglove imports.

    `models` names the versions whose predictions the recording holds, such as `v1` and `v5`.
    """
    topic = plant.get("topics", {}).get("observation", "/joint_states")
    configured: dict[str, Any] = {}
    panels: list[str] = []
    for at, channel in enumerate(plant["observations"]):
        field = channel.get("field") or ("position" if at == 0 else "velocity")
        joint = channel.get("joint")
        path = f'.{field}[:]{{name=="{joint}"}}' if joint else f".{field}[0]"
        signals = [f"{topic}{path}", *(f"/trueup/{m}/prediction{path}" for m in models)]
        residuals = [f"/trueup/{m}/residual{path}" for m in models]
        for kind, paths, colours in (
            ("signal", signals, COLOURS),
            ("residual", residuals, COLOURS[1:]),
        ):
            name = f"Plot!{kind}-{at}"
            configured[name] = {
                "title": f"{channel['name']} [{channel['unit']}]"
                if kind == "signal"
                else f"observed less predicted, {channel['name']}",
                "paths": [_line(p, c) for p, c in zip(paths, colours, strict=False)],
                "showLegend": True,
                "isSynced": True,
                "xAxisVal": "timestamp",
            }
            panels.append(name)
    configured["RawMessages!regions"] = {"topicPath": "/trueup/regions", "diffEnabled": False}
    return {
        "configById": configured,
        "globalVariables": {},
        "userNodes": {},
        "layout": _stacked([*panels, "RawMessages!regions"]),
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
