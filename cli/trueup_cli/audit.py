"""Commands for auditors: read the log, verify it, replay a decision."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Iterator, Mapping
from typing import Annotated, Any, TypeVar

from cyclopts import App, Parameter

from trueup.errors import TrueupError
from trueup_cli.digests import resolve_digest
from trueup_cli.exits import VERIFIES, exit_codes
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
from trueup_cli.replay import Agreed, agreed_file, disagree, made_since, replayed
from trueup_cli.show import as_json, err, lines, moment, progress, say, table
from trueup_client import Client, Witness
from trueup_client.problem import ClientError

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
    again: Annotated[
        bool,
        Parameter(
            negative=(), help="Recompute also what this user's earlier verifications found to agree"
        ),
    ] = False,
    since: Annotated[
        str | None,
        Parameter(
            help="Recompute only decisions made since then: UTC, such as 2026-11-01 or "
            "2026-11-01T12:00; log, rows and bytes are verified whole"
        ),
    ] = None,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Verify the service against its log: every entry, row, byte and decision.

    A decision that agreed before is not recomputed by the same code, since everything that it was
    made from is named by its digest. If anything differs it is listed, and the exit code is 4.
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
        decisions = made_since(client, verified.decisions, since) if replays and not wrong else []
        kept = Agreed(agreed_file(url))
        todo = [d for d in decisions if again or d not in kept]
        for count, (decision, differences) in enumerate(replayed(url, todo), 1):
            bar(0.5 + 0.5 * count / len(todo), f"replayed decision {decision[:12]}")
            wrong += [(f"decisions/{decision}", difference) for difference in differences]
            if not differences:
                kept.add(decision)
    if as_json_:
        figures = {
            "entries": verified.size,
            "root": verified.root.hex(),
            "rows": verified.rows,
            "bytes": verified.bytes,
            "decisions": len(decisions),
            "recomputed": len(todo),
        }
        as_json({**figures, "findings": wrong, "notes": gate_lines.remarks})
    elif wrong:
        table("", ["where", "what does not agree"], wrong)
    else:
        before = len(decisions) - len(todo)
        agreed = f", {before} agreed before" if before else ""
        of_decisions = f", {len(todo)} decisions recomputed{agreed}" if replays else ""
        say(
            (
                "[bold green]holds[/]: {} entries under the signed root {}, {} rows, {:.1f} MB "
                "of episodes and artifacts{}"
            ),
            verified.size,
            base64.b64encode(verified.root).decode(),
            verified.rows,
            verified.bytes / 1e6,
            of_decisions,
        )
    if gate_lines.remarks and not as_json_:
        say("[bold]notes[/]: gates and decisions that were made after candidates had been judged")
        for remark in gate_lines.remarks:
            say("  {}", remark)
    if wrong:
        disagree(f"{len(wrong)} things are not as the log says")


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
