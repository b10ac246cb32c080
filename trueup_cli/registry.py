"""Commands that bring episodes in, fit candidates and judge them."""

from __future__ import annotations

from collections import Counter
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from trueup.errors import BadGate, NotAnEpisode
from trueup_cli.digests import whole
from trueup_cli.options import DEFAULT_URL, Json, PlantName, Seed, Url, connect, read_json
from trueup_cli.show import Bar, answer, as_json, moment, progress, say, table
from trueup_client import Client
from trueup_client.problem import Problem
from trueup_client.records import Decision, Gate, JobWithReads

SENDING = 0.9  # share of the bar for sending; the rest is the service's inspection


def upload(plant: PlantName, *files: Path, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """Upload recordings; the same file again is the same episode.

    Parameters
    ----------
    files
        MCAP files, or folders of them
    """
    client, paths = connect(url), [path for file in files for path in _recordings(file)]
    if not paths:
        raise NotAnEpisode("nothing to upload was named", rule="samples", hint="Name MCAP files, or folders that hold some.")
    found = []
    for path in paths:
        with progress(f"upload {path.name}") as bar:
            try:
                found.append(client.upload_episode(plant, path, partial(_sent, bar)))
            except Problem as problem:
                problem.facts.setdefault("file", str(path))
                raise
    if as_json_:
        as_json(found)
    else:
        warned = Counter(warning for episode in found for warning in episode["summary"].get("collection", {}).get("warnings", []))
        for warning, times in warned.items():
            say("[yellow]{} of {} episodes[/]: {}", times, len(found), warning)
        if warned:
            say("[dim]A recording declares in its metadata record `episode`, a plant in plant.json: docs/plant.md.[/]")
        table(
            "Episodes",
            ["file", "digest", "role", "samples", "seconds"],
            [
                (p.name, e["digest"][:12], e["role"], e["summary"]["samples"], e["summary"]["duration_s"])
                for p, e in zip(paths, found, strict=True)
            ],
        )


def _recordings(path: Path) -> list[Path]:
    """The MCAP files that a path names."""
    if not path.is_dir():
        return [path]
    found = sorted(path.glob("*.mcap"))
    if not found:
        raise NotAnEpisode(f"{path} holds no *.mcap", rule="samples", hint="Name MCAP files, or folders that hold some.")
    return found


def _sent(bar: Bar, share: float) -> None:
    bar(SENDING * share, "sending" if share < 1.0 else "inspecting")


def fit(
    plant: PlantName,
    *,
    method: Annotated[
        Literal["identify", "residual"], Parameter(help="New numbers in the nominal form, or what it misses as a map of features")
    ] = "identify",
    features: Annotated[str | None, Parameter(help="residual only: comma-separated, such as 1,v,u,sign(v),abs(v)")] = None,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Fit a candidate from the plant's adaptation episodes."""
    request: dict[str, Any] = {"kind": "fit", "method": method, **({"features": features.split(",")} if features else {})}
    found = run_job(connect(url), plant, request, f"fit {method}")
    as_json(found) if as_json_ else say("candidate [bold]{}[/]", result_of(found)["artifact"])


def diagnosis(plant: PlantName, *, seed: Seed = 0, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """Diagnose a plant's gap from its uploaded episodes; the corrected model becomes a candidate."""
    found = run_job(connect(url), plant, {"kind": "diagnose", "seed": seed}, "diagnose")
    if as_json_:
        as_json(found)
        return
    answer(result_of(found)["report"])
    say("candidate [bold]{}[/]", result_of(found)["artifact"])
    say("[dim]the whole of it in a browser: trueup look {}[/]", plant)


def gate(
    plant: PlantName,
    candidate: str,
    *,
    rules: Annotated[Path | None, Parameter(help="Gate as JSON; the default gate if none is given")] = None,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Declare a gate, then judge a candidate by it against what serves.

    The default gate asks for rollouts below 0.98 of the incumbent's error and for one step no worse, over every window of the plant's
    horizon in every held-out episode.

    Parameters
    ----------
    candidate
        digest of the artifact, or its first digits
    """
    client = connect(url)
    declared = client.declare_gate(plant, read_json(rules, BadGate) if rules else None)
    request = {"kind": "gate", "candidate": whole_artifact(client, plant, candidate), "gate": declared["digest"]}
    decision = client.decision(plant, result_of(run_job(client, plant, request, "judge"))["decision"])
    as_json(decision) if as_json_ else show_decision(decision, declared)


def versions(plant: PlantName, *, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """List the versions of a plant's model: what was declared, fitted, diagnosed or brought."""
    found = list(connect(url).artifacts(plant))
    as_json(found) if as_json_ else table(
        "",
        ["version", "artifact", "kind", "made by", "added (UTC)", "by"],
        [
            (a["version"], a["digest"][:12], a["kind"], "a job" if a["job"] else "hand", moment(a["created_at"]), a["created_by"])
            for a in found
        ],
    )


def decisions(plant: PlantName, *, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """List what gates decided, the newest first."""
    found = list(connect(url).decisions(plant))
    as_json(found) if as_json_ else table(
        "",
        ["decision", "candidate", "accepted", "against", "gate", "decided (UTC)"],
        [
            (d["digest"][:12], d["candidate"][:12], d["accepted"], d["incumbent"][:12], d["gate"][:12], moment(d["created_at"]))
            for d in found
        ],
    )


def whole_artifact(client: Client, plant: str, given: str) -> str:
    """An artifact's digest by its first digits. Raises NoSuchDigest."""
    return whole(given, client.artifacts(plant), "version", f"trueup versions {plant}")


def run_job(client: Client, plant: str, request: dict[str, Any], what: str) -> JobWithReads:
    """Submit a job and wait for it with a progress bar."""
    job = client.submit(plant, request)
    with progress(what) as bar:
        return client.wait(job["id"], lambda found: bar(found["progress"], found["stage"]))


def result_of(job: JobWithReads) -> dict[str, Any]:
    """What a job that succeeded answers with."""
    return job["result"] or {}


def show_decision(decision: Decision, gate: Gate) -> None:
    """Print a decision with every verdict, and what it was judged on."""
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
        "[dim]on {} of {:g} s in {}, against {}; errors in units of the channels' declared scales[/]",
        windows,
        scoring["horizon_s"],
        held_out,
        decision["incumbent"][:12],
    )
    table(
        "",
        ["rule", "passed", "value", "threshold"],
        [(v["rule"], v["passed"], v["value"], v["threshold"]) for v in decision["document"]["verdicts"]],
    )
