"""Conduct a blind trial with isolated processes, which hold no label."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from trueup.blindtrial.conduct import DiagnoseAll, Progress, Secret, side_by_side
from trueup.blindtrial.conduct import conduct as conduct_with
from trueup.cores import own_cores
from trueup.episode.episode import Episode
from trueup.errors import TrueupError
from trueup.model.plant import Plant
from trueup_worker.isolated_process import NO_ANSWER, IsolatedProcess

SECRET_BYTES = 32


class NoIsolatedProcess(TrueupError):
    """No isolated process could be started to diagnose in."""

    code = "no-room"
    hint = (
        "Install trueup into the environment that runs it: the processes are started "
        "without any other path."
    )


def conduct(
    plant: Plant,
    episodes: Sequence[Episode],
    count: int,
    secret: bytes | None,
    commit: Callable[[list[str]], None],
    progress: Progress,
    diagnose_all: DiagnoseAll | None = None,
    keep: Path | None = None,
) -> dict[str, Any]:
    """Returns the report of `count` trials like a user's plant and episodes.

    With the `secret` of an opened trial it draws that trial again; without one it draws a new
    secret. `commit` is called with the commitments before the first diagnosis. Cases are diagnosed
    by `diagnose_all`, or else by one isolated process for each core. `keep` is a folder for the
    cases, made when the first is written; without one they are removed. Raises NotIdentifiable,
    LabelLeaked, NoIsolatedProcess.
    """
    drawn = Secret(secret or os.urandom(SECRET_BYTES), secret is not None)
    with tempfile.TemporaryDirectory(prefix="blind-") as temporary, ExitStack() as stack:
        if diagnose_all is None:
            diagnose_all = side_by_side(
                [stack.enter_context(IsolatedProcess(core)) for core in own_cores()]
            )
        document = conduct_with(
            plant,
            episodes,
            count,
            drawn,
            commit,
            progress,
            diagnose_all,
            keep or Path(temporary),
        )
    problems = [str(row["problem"]) for row in document["rows"]]
    if all(problem.startswith(NO_ANSWER) for problem in problems):
        raise NoIsolatedProcess(f"no diagnosing process ever answered: {problems[0]}")
    return document
