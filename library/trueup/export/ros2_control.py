"""ros2_control: a proposal of parameters for a controller that compensates what was found.

No controller of ros2_control reads these: they are the numbers that one needs, for whoever writes a
chained controller or adds a feed-forward to their own.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from trueup.export.configuration import heading, interval, number
from trueup.export.joint_drive import Drives, JointDrive, Ranged
from trueup.model.effect import effects

NODE = "compensation_controller"
# of each effect of the command what undoes it
INVERSES = {
    "deadband": ("deadband_inverse", "add the width in the direction of the command"),
    "backlash": ("backlash_inverse", "add the gap at each reversal of the command"),
    "gain_asymmetry": ("gain_inverse", "divide the command by its direction's gain"),
    "actuator_lag": ("lag_inverse", "add time constant x derivative of the command"),
}


def yaml(drives: Drives, report: Mapping[str, Any] | None, version: str) -> str:
    """Parameters of a compensating controller, as YAML."""
    lines = [
        "# A proposal: no controller of ros2_control reads these parameters as they are.",
        "#",
        *(f"# {line}".rstrip() for line in heading(drives, version, [])),
        f"{NODE}:",
        "  ros__parameters:",
        f"    joints: [{', '.join(d.joint for d in drives.drives)}]",
        *(line for d in drives.drives for line in _joint(d, report)),
    ]
    return "\n".join(lines) + "\n"


def _joint(drive: JointDrive, report: Mapping[str, Any] | None) -> Iterator[str]:
    yield f"    {drive.joint}:"
    yield "      friction_feedforward:  # force = coulomb sign(v) + viscous v, v the desired speed"
    yield from _numbers({"coulomb": drive["friction"], "viscous": drive["damping"]})
    if drive["breakaway"].value > drive["friction"].value:
        yield from _numbers({"breakaway": drive["breakaway"]})
    if drive["offset"].value:
        yield "      constant_feedforward:"
        yield from _numbers({"force": Ranged.exactly(-drive["offset"].value)})
    yield "      command_scale:  # the command for a unit of force"
    gain = drive["gain"].value
    yield from _numbers({"per_force": Ranged.exactly(1.0 / gain if gain else 0.0)})
    if drive["delay"].value:
        yield "      delay_prediction:  # predict the state over so long with the corrected model"
        yield from _numbers({"delay_s": drive["delay"]})
    for entry in report["effects"] if report else ():
        if entry["effect"] in INVERSES and entry.get("joint", drive.joint) == drive.joint:
            name, how = INVERSES[entry["effect"]]
            yield f"      {name}:  # {how}"
            yield from _numbers(
                {
                    n: Ranged(e["value"], *(e["ci95"] or (e["value"], e["value"])))
                    for n, e in entry["estimate"].items()
                    if n in {x.name for x in effects()[entry["effect"]].params}
                }
            )


def _numbers(numbers: Mapping[str, Ranged]) -> Iterator[str]:
    for name, value in numbers.items():
        remark = interval(value)
        yield f"        {name}: {number(value.value)}" + (f"  # {remark}" if remark else "")
