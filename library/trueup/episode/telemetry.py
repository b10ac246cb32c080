"""Telemetry: a live batch of samples as JSON, which becomes an episode like any other.

    {"start_ns": "1760000000000000000", "t_s": [0.0, 0.02], "observations": {"q": [0.1, 0.2]},
     "commands": {"u": [0.0, 0.5]}, "conditions": {"payload": "2 kg"}, "role": "telemetry"}

`t_s` [s] counts from `start_ns` [ns since 1970, as text: JSON's numbers are too short]. Every
channel of the plant has one value for each sample; conditions, role (telemetry or reference) and
`applied`, what the drive applied of the commands, may be left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, BinaryIO

import numpy as np
import orjson
from numpy.typing import NDArray

from trueup.episode.layout import Channel, Layout
from trueup.episode.role import Role
from trueup.episode.writer import write_episode
from trueup.errors import NotAnEpisode

ALLOWED = ("start_ns", "t_s", "observations", "commands", "applied", "conditions", "role")
LATEST_NS = 2**31 * 1_000_000_000 - 1  # the seconds of a ROS 2 stamp have 32 bits, with a sign
# a number beyond this is no time of any clock, and would overflow when something is added
LARGEST = 2**62
LONGEST_S = 1e9


def telemetry_to_mcap(data: bytes, layout: Layout, out: BinaryIO) -> None:
    """Write a batch as MCAP. Raises NotAnEpisode, with the rule that the batch breaks."""
    try:
        batch = orjson.loads(data)
    except orjson.JSONDecodeError as error:
        raise NotAnEpisode(f"the batch is not JSON: {error}", rule="json", hint=HINT) from error
    if not isinstance(batch, dict) or set(batch) - set(ALLOWED):
        raise _refused(f"a batch holds {', '.join(ALLOWED)}, nothing else", "fields")
    t_s = _numbers(batch.get("t_s"), "t_s")
    if len(t_s) < 2 or not (t_s[1:] > t_s[:-1]).all():  # noqa: PLR2004  (one sample is no motion)
        raise _refused("t_s needs two times at least, each later than the one before", "t_s")
    start = _start_ns(batch.get("start_ns"))
    stamps_ns = start + np.rint(1e9 * np.clip(t_s, -LONGEST_S, LONGEST_S)).astype(np.int64)
    if np.abs(t_s).max() > LONGEST_S or stamps_ns[0] < 0 or stamps_ns[-1] > LATEST_NS:
        raise _refused(
            (
                "t_s counts seconds from start_ns, lies between 1970 and 2038, and is shorter "
                "than 31 years"
            ),
            "t_s",
        )
    role = batch.get("role", Role.TELEMETRY)
    if role not in (Role.TELEMETRY, Role.REFERENCE):
        raise _refused("the role of a batch is telemetry or reference", "role")
    conditions = batch.get("conditions", {})
    if (
        not isinstance(conditions, dict)
        or not all(isinstance(v, str) for v in conditions.values())
        or "role" in conditions
    ):
        raise _refused("conditions are names with text; the role stands beside them", "conditions")
    write_episode(
        out,
        stamps_ns=stamps_ns,
        observations=_columns(
            batch.get("observations"), layout.observations, len(t_s), "observations"
        ),
        commands=_columns(batch.get("commands"), layout.commands, len(t_s), "commands"),
        layout=layout,
        role=Role(role),
        conditions=conditions,
        applied=_columns(batch["applied"], layout.commands, len(t_s), "applied")
        if "applied" in batch
        else None,
    )


HINT = "docs/continual.md shows a batch of telemetry."


def _refused(message: str, rule: str) -> NotAnEpisode:
    return NotAnEpisode(message, rule=rule, hint=HINT)


def _start_ns(raw: Any) -> int:
    if isinstance(raw, int) and not isinstance(raw, bool):
        raw = str(raw)
    if not isinstance(raw, str) or not raw.isascii() or not raw.isdigit() or int(raw) > LARGEST:
        raise _refused("start_ns is a whole number of nanoseconds since 1970, as text", "start_ns")
    return int(raw)


def _numbers(raw: Any, field: str) -> NDArray[np.float64]:
    if not isinstance(raw, list) or not all(
        isinstance(x, int | float) and not isinstance(x, bool) for x in raw
    ):
        raise _refused(f"{field} must be a list of numbers", field)
    numbers = np.array(raw, np.float64)
    if not np.isfinite(numbers).all():
        raise _refused(f"{field} must be a list of finite numbers", field)
    return numbers


def _columns(
    raw: Any, channels: tuple[Channel, ...], samples: int, field: str
) -> NDArray[np.float64]:
    names = [c.name for c in channels]
    if not isinstance(raw, Mapping) or set(raw) != set(names):
        raise _refused(f"{field} must hold {', '.join(names)}, and nothing else", field)
    columns = [_numbers(raw[name], f"{field}.{name}") for name in names]
    if {len(c) for c in columns} != {samples}:
        raise _refused(f"every channel of {field} needs {samples} values, one for each time", field)
    return np.stack(columns, axis=1)
