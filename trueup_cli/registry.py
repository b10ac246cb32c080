"""Commands that bring episodes in, fit candidates and judge them."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from trueup_cli.options import DEFAULT_URL, Json, PlantName, Seed, Url, connect
from trueup_cli.show import Bar, as_json, out, progress, table
from trueup_client import Client
from trueup_client.records import Decision, JobWithReads

SENDING = 0.9  # share of the bar for sending; the rest is the service's inspection


def upload(plant: PlantName, *files: Path, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """Upload recordings; the same file again is the same episode.

    Parameters
    ----------
    files
        MCAP files, or folders of them
    """
    client, paths = connect(url), [p for f in files for p in (sorted(f.glob("*.mcap")) if f.is_dir() else [f])]
    found = []
    for path in paths:
        with progress(f"upload {path.name}") as bar:
            found.append(client.upload_episode(plant, path, partial(_sent, bar)))
    if as_json_:
        as_json(found)
    else:
        for path, episode in zip(paths, found, strict=True):
            for warning in episode["summary"].get("collection", {}).get("warnings", []):
                out.print(f"[yellow]{path.name}[/]: {warning}")
        table(
            "Episodes",
            ["file", "digest", "role", "samples", "seconds"],
            [
                (p.name, e["digest"][:12], e["role"], e["summary"]["samples"], e["summary"]["duration_s"])
                for p, e in zip(paths, found, strict=True)
            ],
        )


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
    as_json(found) if as_json_ else out.print(f"candidate [bold]{result_of(found)['artifact']}[/]")


def diagnosis(plant: PlantName, *, seed: Seed = 0, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """Diagnose a plant's gap from its uploaded episodes; the corrected model becomes a candidate."""
    found = run_job(connect(url), plant, {"kind": "diagnose", "seed": seed}, "diagnose")
    if as_json_:
        as_json(found)
        return
    from trueup.diagnose.words import sentence

    out.print(sentence(result_of(found)["report"]), soft_wrap=True)
    out.print(f"candidate [bold]{result_of(found)['artifact']}[/]")
    out.print(f"[dim]the whole of it in a browser: trueup look {plant}[/]")


def gate(
    plant: PlantName,
    candidate: str,
    *,
    rules: Annotated[Path | None, Parameter(help="Gate as JSON; the default gate if none is given")] = None,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Declare a gate, then judge a candidate by it against what serves.

    Parameters
    ----------
    candidate
        digest of the artifact
    """
    client = connect(url)
    declared = client.declare_gate(plant, json.loads(rules.read_text()) if rules else None)
    found = run_job(client, plant, {"kind": "gate", "candidate": candidate, "gate": declared["digest"]}, "judge")
    decision = client.decision(plant, result_of(found)["decision"])
    as_json(decision) if as_json_ else show_decision(decision)


def run_job(client: Client, plant: str, request: dict[str, Any], what: str) -> JobWithReads:
    """Submit a job and wait for it with a progress bar."""
    job = client.submit(plant, request)
    with progress(what) as bar:
        return client.wait(job["id"], lambda found: bar(found["progress"], found["stage"]))


def result_of(job: JobWithReads) -> dict[str, Any]:
    """What a job that succeeded answers with."""
    return job["result"] or {}


def show_decision(decision: Decision) -> None:
    """Print a decision with every verdict."""
    word = "[bold green]accepted[/]" if decision["accepted"] else "[bold red]rejected[/]"
    out.print(f"{word}: decision [bold]{decision['digest']}[/] at generation {decision['generation']}")
    table(
        "",
        ["rule", "passed", "value", "threshold"],
        [(v["rule"], v["passed"], v["value"], v["threshold"]) for v in decision["document"]["verdicts"]],
    )
