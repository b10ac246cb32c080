"""What pages say of jobs: what one is called, and how long it waits and takes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

NAMES = {
    "fit": "fit",
    "gate": "trial by the gate",
    "diagnose": "diagnosis",
    "blindtrial": "blind trial",
    "calibrate": "calibration of a monitor",
    "watch": "look at new episodes",
    "validate": "validation",
    "recompute": "recomputation",
    "compare": "comparison",
    "openloop": "study in open loop",
    "closedloop": "study in closed loop",
    "consistency": "consistency study",
    "randomise": "randomisation",
    "excite": "design of an excitation",
}
LOST_S = 30.0  # after which a job that nothing is before should have begun [s]
MINUTES_FROM_S, HOURS_FROM_S = 100.0, 6000.0


def name_of(kind: str) -> str:
    """Returns what a kind of job is called."""
    return NAMES.get(kind, kind)


def about(seconds: float) -> str:
    """Returns a time as people say it."""
    if seconds < MINUTES_FROM_S:
        return f"about {max(seconds, 1.0):.0f} s"
    if seconds < HOURS_FROM_S:
        return f"about {seconds / 60.0:.0f} min"
    return f"about {seconds / 3600.0:.1f} h"


def standing(queued: Any, visible: Sequence[Any], waited_s: float) -> str:
    """Returns where a job stands: `queued` is the job in the queue, `visible` those before it that
    the reader may see, `waited_s` the time since it was submitted [s]."""
    if queued.begun_at is not None:
        takes = f"; such jobs take {about(queued.takes_s)}" if queued.takes_s is not None else ""
        since = queued.begun_at[11:19]
        return f"Worker {queued.worker} has been running it since {since} UTC{takes}."
    if not queued.ahead:
        return (
            f"No worker has taken it for {about(waited_s).removeprefix('about ')}. `trueup work` "
            "starts one."
            if waited_s > LOST_S
            else "A worker takes it next."
        )
    count = len(queued.ahead)
    first = (
        f"a {name_of(visible[0].kind)} of {visible[0].plant}"
        if visible
        else "a job that you cannot see"
    )
    others = "" if count == 1 else f" and {count - 1} other{'s' if count > 2 else ''}"  # noqa: PLR2004
    waits = "" if queued.waits_s is None else f", {about(queued.waits_s)}"
    return f"Waits behind {first}{others}{waits}."
