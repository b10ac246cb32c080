"""Commands that fit candidates and judge them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from trueup.errors import BadGate
from trueup.gate.line import budget_of
from trueup.gate.verdict_text import can_be_settled, reasons, unsettled_words
from trueup_cli.digests import resolve_digest
from trueup_cli.options import (
    DEFAULT_URL,
    ContextSource,
    Json,
    MeasuredParameters,
    PlantName,
    Seed,
    Url,
    connect,
    read_json,
)
from trueup_cli.show import as_json, moment, progress, say, show_diagnosis, table
from trueup_client import Client
from trueup_client.problem import Problem
from trueup_client.records import Decision, GateInLine, JobWithReads

SHORTEST_PREFIX = 7  # digits alone: fewer are a version's number


def fit(
    plant: PlantName,
    *,
    method: Annotated[
        Literal["identify", "residual", "blind", "conditioned"],
        Parameter(
            help="Refit the nominal model's parameters, or fit its residual as a map of features; "
            "or fit one map for a family of plants from its training episodes"
        ),
    ] = "identify",
    episode: Annotated[
        tuple[str, ...],
        Parameter(
            help="Adaptation episode to fit, by its digest or the first digits; give it again for "
            "more; default: all"
        ),
    ] = (),
    context: ContextSource = "identification",
    measured: MeasuredParameters = None,
    features: Annotated[
        str | None,
        Parameter(help="For residual: comma-separated features, such as 1,v,u,sign(v),abs(v)"),
    ] = None,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Fit a candidate from the plant's adaptation episodes, or a family from training episodes."""
    client = connect(url)
    request: dict[str, Any] = {
        "kind": "fit",
        "method": method,
        **({"features": features.split(",")} if features else {}),
        **_only(client, plant, episode),
    }
    if method == "conditioned":
        request["context"] = {"by": context, "parameters": measured}
    job = run_job(client, plant, request, f"fit {method}")
    as_json(job) if as_json_ else say("candidate [bold]{}[/]", result_of(job)["artifact"])


def diagnosis(
    plant: PlantName, *, seed: Seed = 0, url: Url = DEFAULT_URL, as_json_: Json = False
) -> None:
    """Diagnose a plant's uploaded episodes. The corrected model becomes a candidate."""
    job = run_job(connect(url), plant, {"kind": "diagnose", "seed": seed}, "diagnose")
    if as_json_:
        as_json(job)
        return
    show_diagnosis(result_of(job)["report"])
    say("candidate [bold]{}[/]", result_of(job)["artifact"])
    say("[dim]the whole of it in a browser: trueup look {}[/]", plant)


def gate(
    plant: PlantName,
    candidate: str,
    *,
    rules: Annotated[
        Path | None,
        Parameter(
            help=(
                "Gate as a JSON file; default: the plant's gate in force, or the default gate "
                "if it has none"
            )
        ),
    ] = None,
    because: Annotated[
        str | None, Parameter(help="Reason why these rules replace the gate in force")
    ] = None,
    vacuous: Annotated[
        bool,
        Parameter(negative=(), help="Declare the gate although it cannot reject; needs --because"),
    ] = False,
    episode: Annotated[
        tuple[str, ...],
        Parameter(
            negative=(),
            help="Held-out episode to judge on, by its digest or the first digits; give it again "
            "for more; default: all",
        ),
    ] = (),
    scales: Annotated[
        bool,
        Parameter(
            negative=(),
            help=("Also show the verdict with each channel's reporting scale halved and doubled"),
        ),
    ] = False,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Declare a gate, then judge a candidate by it against what serves.

    The default gate requires a rollout error below 0.98 of the incumbent's, and a one-step error
    that is no worse, over every window of the plant's horizon in every held-out episode. Once a
    candidate has been judged, other rules need --because, and every decision by them says what was
    known.

    Parameters
    ----------
    candidate
        number of the version, or the first digits of its digest
    """
    client = connect(url)
    document = None if rules is None else read_json(rules, BadGate)
    if document is not None:
        document = _gate_to_declare(client, plant, document, because, vacuous=vacuous)
    declared = client.declare_gate(plant, document)
    request = {
        "kind": "gate",
        "candidate": resolve_artifact(client, plant, candidate),
        "gate": declared["digest"],
        **_only(client, plant, episode),
        **({"scales": True} if scales else {}),
    }
    result = result_of(run_job(client, plant, request, "judge"))
    decision = client.decision(plant, result["decision"])
    if as_json_:
        as_json({**decision, "scales": result["scales"]} if scales else decision)
        return
    show_decision(decision, client.gate_in_line(plant, declared["digest"]))
    if scales:
        _show_scales(decision, result["scales"])


def _gate_to_declare(
    client: Client, plant: str, document: Any, because: str | None, *, vacuous: bool
) -> Any:
    """Returns a gate's document as it is declared.

    It is the gate in force if their rules are equal. Other rules follow that gate, with a reason.
    """
    if not isinstance(document, dict):
        return document
    wanted = {**document, **({"vacuous": True} if vacuous else {})}
    try:
        in_force: GateInLine | None = client.gate_in_force(plant)
    except Problem as problem:
        if problem.code != "not-found":
            raise
        in_force = None
    if in_force is not None and _rules_of(in_force["document"]) == _rules_of(wanted):
        return in_force["document"]
    if because is None:
        return wanted
    follows = {"follows": in_force["digest"]} if in_force is not None else {}
    return {**follows, **wanted, "because": because}


def _rules_of(document: dict[str, Any]) -> dict[str, Any]:
    """Returns a gate's document without its predecessor and its reason."""
    return {name: value for name, value in document.items() if name not in ("follows", "because")}


def _show_scales(decision: Decision, scaled: list[dict[str, Any]]) -> None:
    """Prints how the verdict depends on each channel's reporting scale."""
    moved = [f["channel"] for f in scaled if f["accepted"] != decision["accepted"]]
    table(
        "With each reporting scale halved and doubled",
        ["channel", "scale", "accepted", *(v["rule"] for v in decision["document"]["verdicts"])],
        [
            (f["channel"], f"× {f['factor']:g}", f["accepted"], *(_ratio(v) for v in f["verdicts"]))
            for f in scaled
        ],
    )
    summary = (
        f"the verdict hangs on the scale of {' and '.join(dict.fromkeys(moved))}"
        if moved
        else "no scale moves the verdict"
    )
    say("{}", summary)


def _ratio(verdict: dict[str, Any]) -> str:
    """Returns a candidate's error over the incumbent's, with its interval."""
    if verdict.get("ratio") is None:
        return ""
    interval = verdict["ci95"]
    return (
        f"{verdict['ratio']:.3g}"
        if interval is None
        else f"{verdict['ratio']:.3g} [{interval[0]:.3g}, {interval[1]:.3g}]"
    )


def versions(plant: PlantName, *, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """List the versions of a plant's model: declared, fitted, diagnosed or imported."""
    client = connect(url)
    artifacts = list(client.artifacts(plant))
    if as_json_:
        as_json(artifacts)
        return
    names = names_of(client, plant, "version")
    table(
        "",
        ["version", "name", "artifact", "kind", "made by", "added (UTC)", "by"],
        [
            (
                a["version"],
                names.get(a["digest"], ""),
                a["digest"][:12],
                a["kind"],
                "a job" if a["job"] else "hand",
                moment(a["created_at"]),
                a["created_by"],
            )
            for a in artifacts
        ],
    )


def decisions(plant: PlantName, *, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """List what gates decided, the newest first."""
    client = connect(url)
    listed = list(client.decisions(plant))
    if as_json_:
        as_json(listed)
        return
    names = names_of(client, plant, "decision")
    table(
        "",
        ["decision", "name", "candidate", "accepted", "against", "gate", "decided (UTC)"],
        [
            (
                d["digest"][:12],
                names.get(d["digest"], ""),
                d["candidate"][:12],
                d["accepted"],
                d["incumbent"][:12],
                d["gate"][:12],
                moment(d["created_at"]),
            )
            for d in listed
        ],
    )


def names_of(client: Client, plant: str, kind: str) -> dict[str, str]:
    """Returns what things of one kind are called, by digest; without those that have no name."""
    labels = client.labels(plant, kind)
    return {one["subject"]: one["name"] for one in labels if one["name"]}


def resolve_artifact(client: Client, plant: str, prefix: str) -> str:
    """Returns an artifact's digest by its version's number or its first digits. Raises
    NoSuchDigest."""
    if prefix.isdigit() and len(prefix) < SHORTEST_PREFIX:
        return str(client.version(plant, int(prefix))["digest"])
    return resolve_digest(prefix, client.artifacts(plant), "version", f"trueup versions {plant}")


def resolve_episode(client: Client, plant: str, prefix: str) -> str:
    """Returns an episode's digest by its first digits. Raises NoSuchDigest."""
    return resolve_digest(prefix, client.episodes(plant), "episode", f"trueup upload {plant} FILE")


def _only(client: Client, plant: str, prefixes: Sequence[str]) -> dict[str, list[str]]:
    """Returns the part of a job's request that names its episodes, empty for all of them. Raises
    NoSuchDigest."""
    named = [resolve_episode(client, plant, prefix) for prefix in prefixes]
    return {"episodes": named} if named else {}


def run_job(client: Client, plant: str, request: dict[str, Any], what: str) -> JobWithReads:
    """Submits a job and waits for it with a progress bar. Raises Problem if it failed."""
    job = client.submit(plant, request)
    with progress(what) as bar:
        return client.wait(job["id"], lambda current: bar(current["progress"], current["stage"]))


def result_of(job: JobWithReads) -> dict[str, Any]:
    """Returns the result of a job that succeeded."""
    return job["result"] or {}


def show_decision(decision: Decision, gate: GateInLine) -> None:
    """Prints a decision with its verdicts, and what was known when its gate was declared."""
    say(
        "[bold green]accepted[/]: decision [bold]{}[/] at generation {}"
        if decision["accepted"]
        else "[bold red]rejected[/]: decision [bold]{}[/] at generation {}",
        decision["digest"],
        decision["generation"],
    )
    scoring, episodes = gate["document"]["scoring"], len(decision["document"]["episodes"])
    windows = "every window" if scoring["windows"] == "every" else "the first window alone"
    held_out = f"{episodes} held-out episode{'s' * (episodes != 1)}"
    say(
        (
            "[dim]on {} of {:g} s in {}, against {}; errors in units of the channels' declared "
            "scales[/]"
        ),
        windows,
        scoring["horizon_s"],
        held_out,
        decision["incumbent"][:12],
    )
    table(
        "",
        ["rule", "passed", "value", "threshold", "ratio [95 %]"],
        [
            (v["rule"], v["passed"], v["value"], v["threshold"], _ratio(v))
            for v in decision["document"]["verdicts"]
        ],
    )
    _show_reasons(decision)
    uses = decision["document"].get("uses")
    if uses:
        say(
            "[dim]held-out episodes used {} of {} times[/]",
            _span(uses),
            budget_of(gate["document"]),
        )
    if decision["disclosure"]:
        say("{}", decision["disclosure"])
    if "because" in gate["document"]:
        say("Its reason: “{}”.", gate["document"]["because"])
    for less in gate["looser_than"]:
        say("It is looser than gate {}: {}.", less["gate"][:12], "; ".join(less["looser"]))


def _show_reasons(decision: Decision) -> None:
    """Prints why a candidate was rejected and what can be done, or which rules it passed by less
    than their interval."""
    verdicts = decision["document"]["verdicts"]
    for verdict in verdicts:
        remark = unsettled_words(verdict)
        if verdict["passed"] and remark:
            say("{} passed, but {}.", verdict["rule"], remark)
    for rule, reason in reasons(verdicts):
        say("{} refuses: {}.", rule, reason)
    if can_be_settled(verdicts):
        plant, candidate = decision["plant"], decision["candidate"][:12]
        say("More held-out recordings could settle it; what was rejected is judged on new ones.")
        say("next: trueup upload {} FILES --role validation", plant)
        say("then: trueup gate {} {} --episode DIGEST --episode …", plant, candidate)


def _span(uses: list[int]) -> str:
    return f"{min(uses)}" if min(uses) == max(uses) else f"{min(uses)} to {max(uses)}"
