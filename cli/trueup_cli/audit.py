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
from trueup_cli.digests import whole
from trueup_cli.exits import DISAGREES, HOLDS, told
from trueup_cli.options import (
    DEFAULT_URL,
    Json,
    PlantName,
    Url,
    connect,
    seen,
    witness_file,
    witnessed,
)
from trueup_cli.show import as_json, err, lines, moment, progress, say, table
from trueup_client import Client, Witness
from trueup_client.problem import ClientError
from trueup_client.records import Decision

T = TypeVar("T")
app = App(name="audit", help="Print or verify the audit log.", help_epilogue=told(HOLDS))


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
        client.plant(
            plant
        )  # raises where there is none: nothing done to it would read as nothing done
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
    """Print the log's signed head, once it was seen to extend the last one that this user saw."""
    note = witnessed(url).checkpoint()
    if as_json_:
        as_json({"checkpoint": note})
    else:
        lines(note)
    say("[dim]seen; kept in {}[/]", witness_file(url), to=err)


@app.command
def key(*, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """Print the log's public key, to be given to robots and auditors by a way of your own."""
    found = connect(url).audit_key()
    as_json({"key": found}) if as_json_ else say("{}", found)


@app.command
def provenance(
    plant: PlantName, digest: str, *, url: Url = DEFAULT_URL, as_json_: Json = False
) -> None:
    """Print where an artifact comes from, or what a gate said, as an in-toto statement; --json for
    its signed envelope.

    Parameters
    ----------
    digest
        digest of an artifact or a decision
    """
    client, witness = seen(url)
    of_decision = any(d["digest"].startswith(digest) for d in client.decisions(plant))
    records, found = (
        (client.decisions, client.decision_provenance)
        if of_decision
        else (client.artifacts, client.artifact_provenance)
    )
    envelope = found(
        plant, whole(digest, records(plant), "artifact or decision", f"trueup versions {plant}")
    )
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
    """Hold the service against its log: every entry, every row, every byte, every decision; exit 4
    with a list if anything differs."""
    from trueup.ledger.gate_lines import GateLineCheck
    from trueup.ledger.verification import verify as hold

    client, witness = seen(url)
    with progress("verifying") as bar:
        labels, lines = _Labels(), GateLineCheck()
        looks = lambda entry: [*labels(entry), *lines(entry)]  # noqa: E731
        found = hold(
            _Service(client, witness),
            lambda share, stage: bar(0.5 * share if replays else share, stage),
            looks,
        )
        wrong = [(f.where, f.what) for f in found.findings]
        for count, decision in enumerate(found.decisions if replays and not wrong else [], 1):
            bar(0.5 + 0.5 * count / len(found.decisions), f"replaying decision {decision[:12]}")
            wrong += [
                (f"decisions/{decision}", difference) for difference in _replayed(client, decision)
            ]
    if as_json_:
        whole = {
            "entries": found.size,
            "root": found.root.hex(),
            "rows": found.rows,
            "bytes": found.bytes,
        }
        as_json({**whole, "findings": wrong, "notes": lines.remarks})
    elif wrong:
        table("", ["where", "what does not agree"], wrong)
    else:
        replayed = f", {len(found.decisions)} decisions recomputed" if replays else ""
        root, megabytes = base64.b64encode(found.root).decode(), found.bytes / 1e6
        say(
            (
                "[bold green]holds[/]: {} entries under the signed root {}, {} rows, {:.1f} MB "
                "of episodes and artifacts{}"
            ),
            found.size,
            root,
            found.rows,
            megabytes,
            replayed,
        )
    if lines.remarks and not as_json_:
        say("[bold]notes[/]: gates and decisions that were made after candidates had been judged")
        for remark in lines.remarks:
            say("  {}", remark)
    if wrong:
        _disagree(f"{len(wrong)} things are not as the log says")


class _Service:
    """A service as what is verified."""

    def __init__(self, client: Client, witness: Witness) -> None:
        self._client, self._witness = client, witness

    def head(self) -> tuple[int, bytes]:
        found = self._client.witness(self._witness)
        return found.size, found.root

    def entries(self, after: int, until: int) -> Iterator[Any]:
        from trueup.ledger.audit import AuditEntry

        for found in _had(self._client.audit(after=after)):
            if found["sequence"] > until:
                return
            yield AuditEntry(**found)

    def nodes(self) -> Iterator[Any]:
        from trueup.ledger.merkle import node_of

        for found in _had(self._client.rows("audit_tree")):
            yield node_of(int(found["node"])), bytes.fromhex(found["hash"])

    def signer(self) -> str | None:
        return self._client.audit_key()

    def rows(self, table: str) -> Iterable[Mapping[str, Any]]:
        return _had(self._client.rows(table))

    def blob(self, digest: str) -> Iterator[bytes]:
        return _had(self._client.blob_parts(digest))


def _had(found: Iterable[T]) -> Iterator[T]:
    """What a service gives; where it fails, that is what is told of it."""
    try:
        yield from found
    except ClientError as error:
        raise TrueupError(f"cannot be had: {error}") from error


class _Labels:
    """Are the labels that a blind trial opened among those that were committed for it before?"""

    def __init__(self) -> None:
        self._committed: dict[str, list[list[str]]] = {}

    def __call__(self, entry: Any) -> list[Any]:
        from trueup.blindtrial.commitment import CommitmentMismatch, require_commitments
        from trueup.ledger.verification import Finding

        if entry.kind == "blindtrial:committed":
            self._committed.setdefault(entry.subject, []).append(entry.facts["commitments"])
        if entry.kind != "job:finished" or "opening" not in entry.facts["result"].get("report", {}):
            return []
        for commitments in self._committed.get(
            entry.subject, []
        ):  # of a worker that was killed before it opened them, another drew anew
            try:
                require_commitments(entry.facts["result"]["report"], commitments)
            except CommitmentMismatch:
                continue
            return []
        return [Finding(f"entry {entry.sequence}", "opens labels that nobody committed")]


def _replayed(client: Client, decision: str) -> list[str]:
    """How a decision differs from what its bytes give."""
    from trueup.gate.recompute import differences

    found = client.find_decision(decision)
    try:
        with tempfile.TemporaryDirectory() as folder:
            return differences(
                found["document"],
                recompute(client, found["plant"], found["document"], Path(folder), lambda *_: None),
            )
    except (TrueupError, ClientError) as error:
        return [f"cannot be recomputed: {error}"]


def _disagree(what: str) -> NoReturn:
    say("[bold red]disagrees[/] {}", what, to=err)
    sys.exit(DISAGREES)


def _told(record: Decision) -> dict[str, Any] | None:
    """A decision's document, if it is the one that its digest names and the columns beside it say
    the same."""
    from trueup.canonical import digest_of

    document: dict[str, Any] = record["document"]
    same = all(
        record[name] == document[name]
        for name in ("gate", "candidate", "incumbent", "generation", "accepted")
    )
    return document if same and digest_of(document) == record["digest"] else None


def replay(decision: str, *, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """Recompute a decision from its gate, its artifacts and its episodes, here, and say whether it
    agrees; exit 4 if not.

    Parameters
    ----------
    decision
        digest of the decision
    """
    from trueup.gate.recompute import differences

    client = witnessed(url)
    found = client.find_decision(decision)
    recorded = _told(found)
    if recorded is None or found["digest"] != decision:
        _disagree(
            "the decision's document is not the one that its digest names, or its columns "
            "say something else"
        )
    try:
        with progress("replay") as bar, tempfile.TemporaryDirectory() as folder:
            recomputed = recompute(client, found["plant"], recorded, Path(folder), bar)
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
    """The decision's document, from verified bytes."""
    from trueup.artifact.model import load
    from trueup.canonical import digest_of
    from trueup.episode.mcap import read_episode
    from trueup.gate import recompute as made_anew

    named = made_anew.models(recorded)
    predictors = {
        name: load(client.fetch(plant, digest, folder / name), digest).predictor
        for name, digest in named.items()
    }
    layout = predictors["candidate"].plant.layout
    episodes = []
    for count, digest in enumerate(recorded["episodes"]):
        path = folder / f"{digest}.mcap"
        client.download_episode(plant, digest, path)
        episodes.append(read_episode(path.read_bytes(), layout))
        progress(0.5 * (count + 1) / len(recorded["episodes"]), "fetching episodes")
    gate, digest = (
        client.gate(plant, recorded["gate"])["document"],
        digest_of(client.plant(plant)["document"]),
    )
    return made_anew.recompute(
        recorded,
        gate,
        predictors,
        episodes,
        digest,
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
            "It does not tell what was known when its gate was declared: trueup audit "
            "verify works it out."
        ),
    )
