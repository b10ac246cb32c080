"""`trueup blindtrial`: how far a verdict on the user's own plant may be trusted."""

from __future__ import annotations

import json
import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from trueup_cli.options import DEFAULT_URL, Url, connect
from trueup_cli.show import out as console
from trueup_cli.show import progress

TRIALS = 60


def run(
    target: str,
    *,
    out: Path,
    trials: Annotated[int, Parameter(help="Machines to draw; each takes as long as a diagnosis")] = TRIALS,
    secret: Annotated[str | None, Parameter(help="64 hexadecimal digits: draw again what a report has opened; CASE only")] = None,
    url: Url = DEFAULT_URL,
) -> None:
    """Hide effects in machines like a user's, diagnose them blindly, and say how often the verdict was right.

    Writes report.json and report.html to a folder; for a case also audit.jsonl, where the labels are committed before the
    first diagnosis, and the recordings under cases/.

    Parameters
    ----------
    target: a case folder, or the name of a plant on the service
    out: folder to write to
    """
    if (Path(target) / "plant.json").is_file():
        document = _local(Path(target), out, trials, bytes.fromhex(secret) if secret else os.urandom(32))
    else:
        from trueup_cli.registry import run_job

        document = run_job(connect(url), target, {"kind": "blindtrial", "trials": trials}, "blind trial")["result"]["report"]
        out.mkdir(parents=True, exist_ok=True)
    write(document, out)
    from trueup.blindtrial.page import sentence

    console.print(sentence(document))
    console.print(f"report: {out / 'report.html'}")


def _local(case: Path, out: Path, trials: int, secret: bytes) -> dict[str, Any]:
    from trueup.diagnose.case import read_case
    from trueup.ledger.audit import GENESIS, append
    from trueup_worker.blind_trial import conduct

    plant, episodes = read_case(case)
    cases = out / "cases"
    cases.mkdir(parents=True)
    after = [(0, GENESIS)]

    def note(kind: str, facts: dict[str, Any]) -> None:
        at = datetime.now(UTC).isoformat()
        entry = append(after[0], at=at, kind=f"blindtrial:{kind}", actor="local", plant=plant.name, subject=plant.digest, facts=facts)
        with (out / "audit.jsonl").open("a") as log:
            log.write(json.dumps({name: getattr(entry, name) for name in entry.__slots__}) + "\n")
            log.flush()
            os.fsync(log.fileno())
        after[0] = entry.sequence, entry.digest

    with progress("blind trial") as bar:
        document = conduct(
            plant,
            episodes,
            trials,
            secret,
            lambda labels: note("committed", {"commitments": labels}),
            lambda stage, share: bar(share, stage),
            keep=cases,
        )
    note("opened", {"labels": [{"label": r["label"], "salt": r["salt"]} for r in document["rows"]], "opening": document["opening"]})
    return document


def write(document: dict[str, Any], out: Path) -> None:
    """The report as JSON and as a page."""
    from trueup.blindtrial.page import page

    (out / "report.json").write_text(json.dumps(document, indent=1) + "\n")
    (out / "report.html").write_text(page(document))
