"""`trueup blindtrial`: how often a diagnosis is right on machines like the user's own."""

from __future__ import annotations

import json
import os
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter
from cyclopts.validators import Number

from trueup.canonical import is_digest
from trueup.errors import TrueupError
from trueup_cli.options import DEFAULT_URL, Json, Url, connect
from trueup_cli.show import as_json, moment, progress, say

TRIALS = 60


def run(
    target: str,
    *,
    out: Path | None = None,
    trials: Annotated[
        int,
        Parameter(
            help="Machines to draw; each takes as long as a diagnosis",
            validator=Number(gte=1, lte=2000),
        ),
    ] = TRIALS,
    secret_file: Annotated[
        Path | None,
        Parameter(help="File with the 64 hexadecimal digits of an opened report, to draw it again"),
    ] = None,
    verify: Annotated[
        bool,
        Parameter(
            negative=(), help="TARGET is a trial's folder: verify its report against its log"
        ),
    ] = False,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Hide effects in simulated machines like the user's, and diagnose them blindly.

    Says how often the verdict was right. Writes report.json and report.html to a folder. For a case
    it also writes the recordings under cases/, and audit.jsonl, which commits to the labels before
    the first diagnosis.

    Parameters
    ----------
    target
        a case folder, or the name of a plant on the service
    out
        folder to write to; default: blindtrial-TARGET
    """
    if verify:
        summary = _verify(Path(target))
        as_json({"holds": True, "said": summary}) if as_json_ else say("{}", summary)
        return
    out = out or Path(f"blindtrial-{Path(target).resolve().name}")
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise NotEmpty(
            f"{out} is not an empty folder",
            hint="Name a folder that is not there yet: labels are committed into a log of its own.",
        )
    if (Path(target) / "plant.json").is_file():
        document = _run_locally(Path(target), out, trials, _read_secret(secret_file))
    else:
        from trueup_cli.registry import result_of, run_job

        document = result_of(
            run_job(connect(url), target, {"kind": "blindtrial", "trials": trials}, "blind trial")
        )["report"]
        out.mkdir(parents=True, exist_ok=True)
    write(document, out)
    from trueup_pages.blindtrial import sentence

    if as_json_:
        as_json(
            {
                "sentence": sentence(document),
                "report": document,
                "files": {"report": str(out / "report.html")},
            }
        )
        return
    say("{}", sentence(document))
    say("report: {}", out / "report.html")


def _verify(trial: Path) -> str:
    """Verifies a trial's report, and returns what holds. Raises BrokenChain, CommitmentMismatch."""
    from trueup.blindtrial.commitment import CommitmentMismatch, require_commitments
    from trueup.errors import BrokenChain
    from trueup.ledger.audit import AuditEntry, append
    from trueup.ledger.merkle import NOTHING

    report, log = trial / "report.json", trial / "audit.jsonl"
    if not (report.is_file() and log.is_file()):
        raise CommitmentMismatch(
            f"{trial} holds no report.json with an audit.jsonl",
            hint="Name the folder that a trial of a case was written to.",
        )
    try:
        lines = [json.loads(line) for line in log.read_text().splitlines()]
        roots = [line.pop("root") for line in lines]
        entries = [AuditEntry(**line) for line in lines]
        document = json.loads(report.read_text())
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise CommitmentMismatch(
            f"{trial} holds a report or a log that was damaged: {error}"
        ) from error
    tree = NOTHING
    for entry, root in zip(entries, roots, strict=True):
        tree = append(tree, entry)
        if tree.root().hex() != root:
            raise BrokenChain(
                f"entry {entry.sequence} is not what was written", sequence=entry.sequence
            )
    committed = entries[0].facts.get("commitments", []) if entries else []
    require_commitments(document, list(committed))  # type: ignore[arg-type]
    return (
        f"{len(document['rows'])} labels are those committed at {moment(entries[0].at)}, "
        "before the first diagnosis."
    )


class NotEmpty(TrueupError):
    """The output would mix with files that are there."""

    code = "not-empty"


class NoSecret(TrueupError):
    """The file holds no secret of a blind trial."""

    code = "no-secret"
    hint = "It holds 64 hexadecimal digits: opening.secret of a report."


def _read_secret(file: Path | None) -> bytes | None:
    if file is None:
        return None
    text = file.read_text(errors="replace").strip() if file.is_file() else ""
    if not is_digest(text):
        raise NoSecret(f"{file} does not hold a secret")
    return bytes.fromhex(text)


def _run_locally(case: Path, out: Path, trials: int, secret: bytes | None) -> dict[str, Any]:
    from trueup.diagnose.case import read_case
    from trueup.ledger.audit import AuditEntry, append
    from trueup.ledger.merkle import NOTHING
    from trueup_worker.blind_trial import conduct

    plant, episodes = read_case(case)
    trees = [NOTHING]

    def note(kind: str, facts: dict[str, Any]) -> None:
        at = datetime.now(UTC).isoformat()
        entry = AuditEntry(
            len(trees), at, f"blindtrial:{kind}", "local", plant.name, plant.digest, facts, {}
        )
        trees.append(append(trees[-1], entry))
        with (out / "audit.jsonl").open("a") as log:
            log.write(json.dumps({**asdict(entry), "root": trees[-1].root().hex()}) + "\n")
            log.flush()
            os.fsync(log.fileno())

    with progress("blind trial") as bar:
        document = conduct(
            plant,
            episodes,
            trials,
            secret,
            lambda labels: note("committed", {"commitments": labels}),
            lambda stage, share: bar(share, stage),
            keep=out / "cases",
        )
    note(
        "opened",
        {
            "labels": [{"label": r["label"], "salt": r["salt"]} for r in document["rows"]],
            "opening": document["opening"],
        },
    )
    return document


def write(document: dict[str, Any], out: Path) -> None:
    """Writes the report as JSON and as a page."""
    from trueup_pages.blindtrial import page

    (out / "report.json").write_text(json.dumps(document, indent=1, allow_nan=False) + "\n")
    (out / "report.html").write_text(page(document))
