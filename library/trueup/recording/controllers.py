"""Controllers: the joints of ros2_control's controllers, as their parameter file lists them.

A `Float64MultiArray` has no names: its entries are the `joints` of the controller that it is sent
to, in that order.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from trueup.errors import BadMapping
from trueup.recording.format import optional

PARAMETERS = "ros__parameters"


def read_controllers(file: Path) -> dict[str, tuple[str, ...]]:
    """The joints of each controller by its name, of a YAML file of parameters. Raises BadMapping,
    NotInstalled."""
    yaml = optional("ruamel.yaml", "ros", "controllers' parameters")
    try:
        document = yaml.YAML(typ="safe", pure=True).load(file.read_text())
    except (yaml.error.YAMLError, UnicodeDecodeError) as error:
        raise BadMapping(f"{file.name} is no YAML: {error}", field="controllers") from error
    controllers = dict(_controllers(document))
    if not controllers:
        raise BadMapping(
            f"no controller of {file.name} lists its joints",
            field="controllers",
            hint=f"Name a file in which a controller has {PARAMETERS} with joints.",
        )
    return controllers


def _controllers(node: Any, name: str = "") -> list[tuple[str, tuple[str, ...]]]:
    """Every node with parameters that list joints; namespaces nest."""
    if not isinstance(node, Mapping):
        return []
    own = node.get(PARAMETERS)
    if isinstance(own, Mapping):
        joints = own.get("joints") or ([own["joint"]] if isinstance(own.get("joint"), str) else [])
        if isinstance(joints, list) and joints and all(isinstance(j, str) for j in joints):
            return [(name, tuple(joints))]
        return []
    return [
        pair for key, inner in node.items() for pair in _controllers(inner, str(key).strip("/"))
    ]


def joints_at(topic: str, controllers: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
    """The joints of the controller that a topic belongs to, none where it is none's."""
    parts = topic.strip("/").split("/")
    return next((joints for name, joints in controllers.items() if name in parts), ())
