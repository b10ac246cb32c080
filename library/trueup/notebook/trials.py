"""How far a diagnosis may be trusted on machines like these."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from trueup.blindtrial.conduct import Secret, conduct, side_by_side
from trueup.blindtrial.diagnosing import answer_of
from trueup.cores import cores
from trueup.notebook.case import Case
from trueup.notebook.diagnosis import Progress, shown

SECRET_BYTES = 32


@dataclass(frozen=True)
class BlindTrial:
    """How a trial went. `report` is the whole of it as JSON, as `trueup blindtrial` writes it."""

    report: Mapping[str, Any]

    @property
    def exact(self) -> float:
        """The share of machines whose answer was exactly what was hidden."""
        rows = self.report["rows"]
        return sum(bool(row["exact"]) for row in rows) / len(rows)

    @property
    def misses(self) -> list[tuple[str, str]]:
        """Of each machine that was missed what was hidden in it, and what was answered."""
        return [
            (", ".join(row["label"]["effects"]) or str(row["label"]["kind"]), str(row["answer"]))
            for row in self.report["rows"]
            if not row["exact"]
        ]

    def __repr__(self) -> str:
        count = self.report["trials"]
        right = round(self.exact * count)
        return f"{right} of {count} machines like {self.report['plant']} were answered exactly."

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><td>{escape(hidden)}</td><td>{escape(answer)}</td></tr>"
            for hidden, answer in self.misses
        )
        table = (
            f"<table><thead><tr><th>hidden</th><th>answered</th></tr></thead><tbody>{rows}</tbody>"
            "</table>"
            if rows
            else ""
        )
        return f"<p><strong>{escape(repr(self))}</strong></p>{table}"


def blind_trial(case: Case, *, trials: int = 60, progress: bool | Progress = False) -> BlindTrial:
    """Hide random effects in simulated machines like the one of a case, diagnose their recordings,
    and compare the answers with what was hidden.

    It takes as long as so many diagnoses. They are made in this process, by functions that get the
    recordings alone; `trueup blindtrial` makes them in isolated processes and commits what is
    hidden beforehand, for somebody who does not take your word. Raises NotIdentifiable.
    """
    with TemporaryDirectory(prefix="blind-") as folder:
        report = conduct(
            case.plant,
            case.episodes,
            trials,
            Secret(os.urandom(SECRET_BYTES)),
            lambda _: None,
            shown(progress),
            side_by_side([partial(answer_of, clock_s=_no_clock)] * cores()),
            Path(folder),
        )
    return BlindTrial(report)


def _no_clock() -> float:
    return 0.0
