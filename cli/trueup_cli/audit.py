"""Commands for auditors: read the log, verify it, replay a decision."""

from __future__ import annotations

import base64
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, NoReturn, TypeVar

from cyclopts import App, Parameter

from trueup.errors import TrueupError
from trueup_cli.digests import resolve_digest
from trueup_cli.exits import DISAGREES, VERIFIES, exit_codes
from trueup_cli.options import (
    DEFAULT_URL,
    Json,
    PlantName,
    Url,
    connect,
    connect_with_witness,
    connect_witnessed,
    witness_file,
)
from trueup_cli.show import as_json, err, lines, moment, progress, say, table
from trueup_client import Client, Witness
from trueup_client.problem import ClientError
from trueup_client.records import Decision

T = TypeVar("T")
app = App(name="audit", help="Print or verify the audit log.", help_epilogue=exit_codes(VERIFIES))


@app.default
def audit(
    plant: PlantName | None = None, *, url: Url = DEFAULT_URL, as_json_: Json = False
) -> None:
    """Print the audit log.

    Parameters
    ----------
    plant
        only the entries of this plant
    """
    client = connect(url)
    if plant is not None:
        client.plant(plant)  # raises if there is no such plant, which has no entries either
    entries = list(client.audit(plant))
    if as_json_:
        as_json(entries)
    else:
        table(
            "Audit log",
            ["#", "at", "what", "operation", "subject", "actor"],
            [
                (
                    e["sequence"],
                    moment(e["at"]),
                    e["kind"],
                    e["facts"].get("operation") or "",
                    e["subject"][:12],
                    e["actor"],
                )
                for e in entries
            ],
        )


@app.command
def checkpoint(*, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """Print the log's signed head, once it was checked to extend the last one this user saw."""
    note = connect_witnessed(url).checkpoint()
    if as_json_:
        as_json({"checkpoint": note})
    else:
        lines(note)
    say("[dim]seen; kept in {}[/]", witness_file(url), to=err)


@app.command
def key(*, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """Print the log's public key, for you to hand to robots and auditors."""
    text = connect(url).audit_key()
    as_json({"key": text}) if as_json_ else say("{}", text)


@app.command
def provenance(
    plant: PlantName, digest: str, *, url: Url = DEFAULT_URL, as_json_: Json = False
) -> None:
    """Print where an artifact comes from, or what a gate decided, as an in-toto statement.

    With --json it is the signed envelope.

    Parameters
    ----------
    digest
        digest of an artifact or a decision
    """
    client, witness = connect_with_witness(url)
    of_decision = any(d["digest"].startswith(digest) for d in client.decisions(plant))
    records, provenance_of = (
        (client.decisions, client.decision_provenance)
        if of_decision
        else (client.artifacts, client.artifact_provenance)
    )
    whole = resolve_digest(
        digest, records(plant), "artifact or decision", f"trueup versions {plant}"
    )
    envelope = provenance_of(plant, whole)
    assert witness.key is not None
    statement = witness.key.payload(envelope, envelope["payloadType"])
    as_json(envelope if as_json_ else statement)


@app.command
def verify(
    *,
    replays: Annotated[
        bool, Parameter(negative="--no-replay", help="Recompute every decision from its bytes")
    ] = True,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Verify the service against its log: every entry, row, byte and decision.

    If anything differs it is listed, and the exit code is 4.
    """
    from trueup.ledger.gate_lines import GateLineCheck
    from trueup.ledger.verification import verify as verify_log

    client, witness = connect_with_witness(url)
    with progress("verifying") as bar:
        labels, gate_lines = _LabelCheck(), GateLineCheck()
        verified = verify_log(
            _RemoteLog(client, witness),
            lambda share, stage: bar(0.5 * share if replays else share, stage),
            lambda entry: [*labels(entry), *gate_lines(entry)],
        )
        wrong = [(f.where, f.what) for f in verified.findings]
        decisions = verified.decisions if replays and not wrong else []
        for count, decision in enumerate(decisions, 1):
            bar(0.5 + 0.5 * count / len(decisions), f"replaying decision {decision[:12]}")
            wrong += [
                (f"decisions/{decision}", difference)
                for difference in _replay_differences(client, decision)
            ]
    if as_json_:
        figures = {
            "entries": verified.size,
            "root": verified.root.hex(),
            "rows": verified.rows,
            "bytes": verified.bytes,
        }
        as_json({**figures, "findings": wrong, "notes": gate_lines.remarks})
    elif wrong:
        table("", ["where", "what does not agree"], wrong)
    else:
        replayed = f", {len(verified.decisions)} decisions recomputed" if replays else ""
        say(
            (
                "[bold green]holds[/]: {} entries under the signed root {}, {} rows, {:.1f} MB "
                "of episodes and artifacts{}"
            ),
            verified.size,
            base64.b64encode(verified.root).decode(),
            verified.rows,
            verified.bytes / 1e6,
            replayed,
        )
    if gate_lines.remarks and not as_json_:
        say("[bold]notes[/]: gates and decisions that were made after candidates had been judged")
        for remark in gate_lines.remarks:
            say("  {}", remark)
    if wrong:
        _disagree(f"{len(wrong)} things are not as the log says")


class _RemoteLog:
    """A service's log, rows and bytes, as the verification reads them."""

    def __init__(self, client: Client, witness: Witness) -> None:
        self._client, self._witness = client, witness

    def head(self) -> tuple[int, bytes]:
        checkpoint = self._client.witness(self._witness)
        return checkpoint.size, checkpoint.root

    def entries(self, after: int, until: int) -> Iterator[Any]:
        from trueup.ledger.audit import AuditEntry

        for entry in _or_verification_error(self._client.audit(after=after)):
            if entry["sequence"] > until:
                return
            yield AuditEntry(**entry)

    def nodes(self) -> Iterator[Any]:
        from trueup.ledger.merkle import node_of

        for row in _or_verification_error(self._client.rows("audit_tree")):
            yield node_of(int(row["node"])), bytes.fromhex(row["hash"])

    def signer(self) -> str | None:
        return self._client.audit_key()

    def rows(self, table: str) -> Iterable[Mapping[str, Any]]:
        return _or_verification_error(self._client.rows(table))

    def blob(self, digest: str) -> Iterator[bytes]:
        return _or_verification_error(self._client.blob_parts(digest))


def _or_verification_error(items: Iterable[T]) -> Iterator[T]:
    """Yields what a service answers. Raises TrueupError, which the verification reports."""
    try:
        yield from items
    except ClientError as error:
        raise TrueupError(f"cannot be had: {error}") from error


class _LabelCheck:
    """Checks that the labels that a blind trial opens were committed for it before."""

    def __init__(self) -> None:
        self._committed: dict[str, list[list[str]]] = {}

    def __call__(self, entry: Any) -> list[Any]:
        from trueup.blindtrial.commitment import CommitmentMismatch, require_commitments
        from trueup.ledger.verification import Finding

        if entry.kind == "blindtrial:committed":
            self._committed.setdefault(entry.subject, []).append(entry.facts["commitments"])
        if entry.kind != "job:finished" or "opening" not in entry.facts["result"].get("report", {}):
            return []
        # a worker that takes over a trial draws and commits anew: one of the commitments must hold
        for commitments in self._committed.get(entry.subject, []):
            try:
                require_commitments(entry.facts["result"]["report"], commitments)
            except CommitmentMismatch:
                continue
            return []
        return [Finding(f"entry {entry.sequence}", "opens labels that nobody committed")]


def _replay_differences(client: Client, decision: str) -> list[str]:
    """Returns how a decision differs from the one that its bytes give."""
    from trueup.gate.recompute import differences

    record = client.find_decision(decision)
    recorded = record["document"]
    try:
        with tempfile.TemporaryDirectory() as folder:
            recomputed = recompute(client, record["plant"], recorded, Path(folder), lambda *_: None)
            return differences(recorded, recomputed)
    except (TrueupError, ClientError) as error:
        return [f"cannot be recomputed: {error}"]


def _disagree(what: str) -> NoReturn:
    say("[bold red]disagrees[/] {}", what, to=err)
    sys.exit(DISAGREES)


def _consistent_document(record: Decision) -> dict[str, Any] | None:
    """Returns a decision's document; None if its digest or its columns do not match it."""
    from trueup.canonical import digest_of

    document: dict[str, Any] = record["document"]
    same = all(
        record[name] == document[name]
        for name in ("gate", "candidate", "incumbent", "generation", "accepted")
    )
    return document if same and digest_of(document) == record["digest"] else None


def replay(decision: str, *, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """Recompute a decision here from its gate, artifacts and episodes, and check that it agrees.

    The exit code is 4 if it does not.

    Parameters
    ----------
    decision
        digest of the decision
    """
    from trueup.gate.recompute import differences

    client = connect_witnessed(url)
    record = client.find_decision(decision)
    recorded = _consistent_document(record)
    if recorded is None or record["digest"] != decision:
        _disagree(
            "the decision's document is not the one that its digest names, or its columns "
            "say something else"
        )
    try:
        with progress("replay") as bar, tempfile.TemporaryDirectory() as folder:
            recomputed = recompute(client, record["plant"], recorded, Path(folder), bar)
    except TrueupError as error:
        _disagree(f"{error.code}: {error.message}")
    wrong = differences(recorded, recomputed)
    if as_json_:
        as_json(
            {
                "decision": decision,
                "agrees": not wrong,
                "differences": wrong,
                "recomputed": recomputed,
            }
        )
    else:
        _show(recorded, recomputed, wrong)
    if wrong:
        sys.exit(DISAGREES)


def recompute(
    client: Client, plant: str, recorded: dict[str, Any], folder: Path, progress: Any
) -> dict[str, Any]:
    """Recomputes a decision's document from verified bytes, which it fetches into `folder`."""
    from trueup.artifact.model import load
    from trueup.canonical import digest_of
    from trueup.episode.mcap import read_episode
    from trueup.gate import recompute as recomputation

    predictors = {
        name: load(client.fetch(plant, digest, folder / name), digest).predictor
        for name, digest in recomputation.models(recorded).items()
    }
    layout = predictors["candidate"].plant.layout
    episodes = []
    for count, digest in enumerate(recorded["episodes"]):
        path = folder / f"{digest}.mcap"
        client.download_episode(plant, digest, path)
        episodes.append(read_episode(path.read_bytes(), layout))
        progress(0.5 * (count + 1) / len(recorded["episodes"]), "fetching episodes")
    return recomputation.recompute(
        recorded,
        client.gate(plant, recorded["gate"])["document"],
        predictors,
        episodes,
        digest_of(client.plant(plant)["document"]),
        lambda share: progress(0.5 + 0.5 * share, "scoring"),
    )


def _show(recorded: dict[str, Any], recomputed: dict[str, Any], differences: list[str]) -> None:
    from trueup.gate.line import disclosure

    pairs = zip(recorded["verdicts"], recomputed["verdicts"], strict=True)
    table(
        "",
        ["rule", "recorded", "recomputed", "threshold", "passed"],
        [(a["rule"], a["value"], b["value"], b["threshold"], b["passed"]) for a, b in pairs],
    )
    say(
        "[bold red]disagrees[/]"
        if differences
        else "[bold green]agrees[/]: every figure and the verdict"
    )
    for difference in differences:
        say("{}", difference)
    say(
        "{}",
        disclosure(recorded)
        or (
            "It does not say what was known when its gate was declared: trueup audit "
            "verify works it out."
        ),
    )
