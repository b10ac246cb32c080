"""Commands for auditors: read the log, verify it, replay a decision."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Annotated, Any, NoReturn

from cyclopts import Parameter
from rich.markup import escape

from trueup.errors import TrueupError
from trueup_cli.complaints import EXIT_DISAGREES
from trueup_cli.options import DEFAULT_URL, Json, Url, connect
from trueup_cli.show import as_json, err, moment, out, progress, table
from trueup_client import Client

AGREEMENT = 1e-9  # relative: matrix products differ by some 1e-13 between processors


def audit(
    plant: str | None = None,
    *,
    verify: Annotated[bool, Parameter(negative=(), help="Recompute every digest of the chain")] = False,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Print the audit log.

    Parameters
    ----------
    plant: only the entries of this plant
    """
    client = connect(url)
    if verify:
        _verify(client)
        return
    entries = list(client.audit(plant))
    if as_json_:
        as_json(entries)
    else:
        table(
            "Audit log",
            ["#", "at", "what", "operation", "subject", "actor"],
            [
                (e["sequence"], moment(e["at"]), e["kind"], e["facts"].get("operation") or "", e["subject"][:12], e["actor"])
                for e in entries
            ],
        )


def _verify(client: Client) -> None:
    """Hold the chain against its head, and everything that it tells against what the service answers with."""
    from trueup.errors import BrokenChain
    from trueup.ledger.audit import AuditEntry
    from trueup.ledger.audit import verify as verify_chain

    head = client.audit_head()
    entries = [e for e in client.audit() if e["sequence"] <= head["sequence"]]
    try:
        last = verify_chain(AuditEntry(**e) for e in entries)
    except BrokenChain as error:
        _disagree(error.message)
    if last != (head["sequence"], head["digest"]):
        _disagree(f"the log ends at {last[0]}, its head says {head['sequence']}")
    with progress("holding what is served against the log") as bar:
        for count, entry in enumerate(entries, 1):
            _hold(client, entry)
            _hold_labels(entry, entries)
            bar(count / len(entries), entry["kind"])
        for plant in {e["plant"] for e in entries if e["plant"]}:
            _hold_moves(client, plant, [e for e in entries if e["plant"] == plant])
    out.print(f"{last[0]} entries hold, and what they tell is what is served; head {last[1]}")


def _disagree(what: str) -> NoReturn:
    err.print(f"[bold red]disagrees[/] {escape(what)}", soft_wrap=True)
    sys.exit(EXIT_DISAGREES)


def _hold_labels(finished: dict[str, Any], entries: list[dict[str, Any]]) -> None:
    """Are the labels that a blind trial opened among those that were committed for it before?"""
    from trueup.blindtrial.seal import NotAsCommitted, require_as_committed

    if finished["kind"] != "job:finished" or "report" not in (result := finished["facts"]["result"]) or "opening" not in result["report"]:
        return
    mine = [e for e in entries if e["subject"] == finished["subject"] and e["sequence"] < finished["sequence"]]
    for entry in (e for e in mine if e["kind"] == "blindtrial:committed"):
        try:
            require_as_committed(result["report"], entry["facts"]["commitments"])
        except NotAsCommitted:
            continue  # its worker was killed before it opened them; another drew and committed anew
        return
    _disagree(f"entry {finished['sequence']} opens labels that nobody committed")


def _hold(client: Client, entry: dict[str, Any]) -> None:
    """Is what an entry tells of still what the service gives for it?"""
    from trueup.canonical import digest_of

    plant, subject, facts = entry["plant"], entry["subject"], entry["facts"]
    if entry["kind"] == "plant:registered":
        found: Any = digest_of(client.plant(plant)["document"]), subject
    elif entry["kind"] == "gate:declared":
        found = digest_of(client.gate(plant, subject)["document"]), digest_of(facts["gate"])
    elif entry["kind"] == "decision:made":
        found = _told(client.find_decision(subject)), facts["decision"]
    elif entry["kind"] == "artifact:added":
        record = client.artifact(plant, subject)
        found = (
            (record["version"], record["kind"], record["arrays"], client.manifest_digest(plant, subject)),
            (facts["version"], facts["kind"], facts["arrays"], subject),
        )
    elif entry["kind"] == "episode:ingested":
        found = client.episode(plant, subject)["role"], facts["role"]
    else:
        return
    if found[0] != found[1]:
        _disagree(f"entry {entry['sequence']}, {entry['kind']} {subject[:12]}: the service gives something else")


def _told(record: dict[str, Any]) -> dict[str, Any] | None:
    """A decision's document, if it is the one that its digest names and the columns beside it say the same."""
    from trueup.canonical import digest_of

    document: dict[str, Any] = record["document"]
    same = all(record[name] == document[name] for name in ("gate", "candidate", "incumbent", "generation", "accepted"))
    return document if same and digest_of(document) == record["digest"] else None


def _hold_moves(client: Client, plant: str, entries: list[dict[str, Any]]) -> None:
    """Every position of the pointer must be told by an entry, and every entry must be a position."""
    told = []
    for entry in entries:
        facts = entry["facts"]
        if entry["kind"] == "plant:registered":
            told.append((facts["generation"], "registered", facts["artifact"], entry["actor"]))
        elif entry["kind"] == "pointer:moved":
            told.append((facts["generation"], facts["move"], entry["subject"], entry["actor"]))
    if told != [(m.generation, m.move, m.artifact, m.actor) for m in client.history(plant)]:
        _disagree(f"the pointer of {plant} has positions that the log does not tell of, or not so")


def replay(decision: str, *, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """Recompute a decision from its gate, its artifacts and its episodes, here, and say whether it agrees; exit 4 if not.

    Parameters
    ----------
    decision: digest of the decision
    """
    client = connect(url)
    found = client.find_decision(decision)
    recorded = _told(found)
    if recorded is None or found["digest"] != decision:
        _disagree("the decision's document is not the one that its digest names, or its columns say something else")
    try:
        with progress("replay") as bar, tempfile.TemporaryDirectory() as folder:
            recomputed = recompute(client, found["plant"], recorded, Path(folder), bar)
    except TrueupError as error:
        _disagree(f"{error.code}: {error.message}")
    differences = compare(recorded, recomputed)
    if as_json_:
        as_json({"decision": decision, "agrees": not differences, "differences": differences, "recomputed": recomputed})
    else:
        _show(recorded, recomputed, differences)
    if differences:
        sys.exit(EXIT_DISAGREES)


def recompute(client: Client, plant: str, recorded: dict[str, Any], folder: Path, progress: Any) -> dict[str, Any]:
    """The decision's document, from verified bytes."""
    from trueup.canonical import digest_of
    from trueup.episode.mcap import read_episode
    from trueup.errors import BadGate
    from trueup.gate.decision import Gate
    from trueup.gate.judge import judge, run_trial
    from trueup_cli.model_folder import load_predictor

    gate = Gate.from_document(client.gate(plant, recorded["gate"])["document"])
    if gate.digest != recorded["gate"]:
        raise BadGate("the gate is not the one that the decision names", expected=recorded["gate"], found=gate.digest)
    predictors = [
        load_predictor(client.fetch(plant, recorded[which], folder / which), recorded[which]) for which in ("candidate", "incumbent")
    ]
    episodes = []
    for count, digest in enumerate(recorded["episodes"]):
        path = folder / f"{digest}.mcap"
        client.download_episode(plant, digest, path)
        episodes.append(read_episode(path.read_bytes(), predictors[0].plant.layout))
        progress(0.5 * (count + 1) / len(recorded["episodes"]), "fetching episodes")
    trial = run_trial(gate, predictors[0], predictors[1], episodes, lambda share: progress(0.5 + 0.5 * share, "scoring"))
    plant_digest = digest_of(client.plant(plant)["document"])
    return judge(
        gate, trial, plant=plant_digest, candidate=recorded["candidate"], incumbent=recorded["incumbent"], generation=recorded["generation"]
    ).document()


def compare(recorded: Any, recomputed: Any, path: str = "") -> list[str]:
    """Where two documents differ by more than rounding; texts that only repeat figures are left out."""
    if isinstance(recorded, dict) and isinstance(recomputed, dict) and set(recorded) == set(recomputed):
        return [
            d for key in recorded if key != "because" for d in compare(recorded[key], recomputed[key], f"{path}.{key}" if path else key)
        ]
    if isinstance(recorded, list) and isinstance(recomputed, list) and len(recorded) == len(recomputed):
        return [d for i, pair in enumerate(zip(recorded, recomputed, strict=True)) for d in compare(*pair, f"{path}[{i}]")]
    numbers = all(isinstance(x, int | float) and not isinstance(x, bool) for x in (recorded, recomputed))
    same = abs(recorded - recomputed) <= AGREEMENT * max(abs(recorded), abs(recomputed)) if numbers else recorded == recomputed
    return [] if same else [f"{path}: recorded {recorded}, recomputed {recomputed}"]


def _show(recorded: dict[str, Any], recomputed: dict[str, Any], differences: list[str]) -> None:
    pairs = zip(recorded["verdicts"], recomputed["verdicts"], strict=True)
    table(
        "",
        ["rule", "recorded", "recomputed", "threshold", "passed"],
        [(a["rule"], a["value"], b["value"], b["threshold"], b["passed"]) for a, b in pairs],
    )
    out.print(
        "[bold green]agrees[/]: every figure and the verdict" if not differences else "[bold red]disagrees[/]\n" + "\n".join(differences)
    )
