"""`trueup demo`: the main job on a real recording, with a server and worker on embedded storage."""

from __future__ import annotations

import json
import shutil
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.text import Text

from trueup.artifact.model import load
from trueup.episode.episode import Episode
from trueup.episode.mcap import read_episode
from trueup.fit.score import rollout_rms
from trueup.gate.recompute import differences
from trueup.model.nominal_form import resolved
from trueup.model.predictor import Predictor, predict_episode
from trueup.model.windows import starts_every
from trueup_cli.embedded_service import admin_token, embedded_service
from trueup_cli.pictures.before_and_after import AFTER, BEFORE, Trace, before_and_after
from trueup_cli.registry import result_of, run_job, show_decision
from trueup_cli.replay import recompute
from trueup_cli.serving import show_serving
from trueup_cli.show import progress, say, show_diagnosis, table
from trueup_client import Client
from trueup_client.records import Decision

EXAMPLE = Path(__file__).parents[2] / "examples" / "emps"
FRICTION = ["1", "v", "u", "sign(v)", "abs(v)"]
CANDIDATES: dict[str, dict[str, Any]] = {
    "identified parameters": {"kind": "fit", "method": "identify"},
    "nominal + quadratic residual": {"kind": "fit", "method": "residual"},
    "nominal + friction residual": {"kind": "fit", "method": "residual", "features": FRICTION},
    "diagnosed effects": {"kind": "diagnose"},
}
OF_ROBOTS = ("identified parameters", "diagnosed effects")
DEMO = Path(".trueup/demo")


@dataclass(frozen=True)
class Case:
    """The demo's plant and recordings, and the folder that it writes to."""

    folder: Path
    work: Path
    plant: dict[str, Any]

    @property
    def is_robot(self) -> bool:
        """Whether the nominal model is given as MJCF."""
        return "mjcf" in self.plant["nominal"]

    @property
    def name(self) -> str:
        """The plant's name."""
        return str(self.plant["name"])


def demo(case: Path | None = None, *, work: Path = DEMO) -> None:
    """Register a plant, upload recordings, fit candidates and diagnose, gate, promote, predict,
    roll back, promote again, and show the audit trail.

    Parameters
    ----------
    case
        case folder with plant.json, gate.json and *.mcap; default: recordings of a linear axis
    work
        folder for the demo's own storage, model and picture; emptied first
    """
    began = time.monotonic()
    shutil.rmtree(work, ignore_errors=True)
    folder = case or EXAMPLE
    plant = resolved(json.loads((folder / "plant.json").read_text()), folder)
    shown = Case(folder, work, plant)
    with embedded_service(work / "data") as (url, _):
        client = Client(url, actor="demo", token=admin_token(work / "data"))
        _upload(client, shown)
        best = _fit_and_gate(client, shown)
        if best is None:
            say("\nNo candidate was accepted: the nominal model keeps serving.")
        else:
            _promote_and_predict(client, shown, best)
            _roll_back(client, shown)
            _promote_again(client, shown, best)
        _audit(client)
    say(
        "\n[dim]done in {:.0f} s; storage, model and picture are in {}[/]",
        time.monotonic() - began,
        work,
    )
    say(
        "[dim]look at it in a browser: {}[/]",
        "make look" if work == DEMO else f"trueup look --data {work}/data",
    )


def _heading(step: int, what: str) -> None:
    say("\n[bold]{}  {}[/]", step, what)


def _upload(client: Client, case: Case) -> None:
    nominal = case.plant["nominal"]
    described = f"in {nominal['mjcf']}" if case.is_robot else f"of the family {nominal['family']}"
    say(
        "[bold]{}[/]: {} recordings, a nominal model {}",
        case.name,
        len(list(case.folder.glob("*.mcap"))),
        described,
    )
    _heading(1, "Register the plant, upload the recordings")
    client.register_plant(case.plant)
    uploaded = []
    with progress("uploading and inspecting") as bar:
        paths = sorted(case.folder.glob("*.mcap"))
        for done, path in enumerate(paths, 1):
            uploaded.append(client.upload_episode(case.name, path))
            bar(done / len(paths), path.name)
    table(
        "",
        ["episode", "role", "samples", "seconds"],
        [
            (e["digest"][:12], e["role"], e["summary"]["samples"], e["summary"]["duration_s"])
            for e in uploaded
        ],
    )


def _fit_and_gate(client: Client, case: Case) -> Decision | None:
    """Returns the decision on the accepted candidate with the smallest rollout error, if any."""
    _heading(2, "Declare the gate, before anything is scored")
    gate = client.declare_gate(case.name, json.loads((case.folder / "gate.json").read_text()))
    rules, horizon_s = (
        ", ".join(r["rule"] for r in gate["document"]["rules"]),
        gate["document"]["scoring"]["horizon_s"],
    )
    say("gate {}: {}, over windows of {:g} s", gate["digest"][:12], rules, horizon_s)
    _heading(
        3,
        (
            "Fit candidates from the adaptation episodes and diagnose the gap; judge each "
            "on the validation episodes"
        ),
    )
    rows, decisions = [], []
    for name, request in CANDIDATES.items():
        if case.is_robot and name not in OF_ROBOTS:
            continue
        result = result_of(run_job(client, case.name, request, request["kind"]))
        artifact = result["artifact"]
        if "report" in result:
            show_diagnosis(result["report"])
        judged = run_job(
            client,
            case.name,
            {"kind": "gate", "candidate": artifact, "gate": gate["digest"]},
            "judge",
        )
        decisions.append(client.decision(case.name, result_of(judged)["decision"]))
        figures = {v["rule"]: v["value"] for v in decisions[-1]["document"]["verdicts"]}
        rows.append(
            (
                name,
                artifact[:12],
                figures["rollout_improves"],
                figures["one_step_no_worse"],
                Text("accepted", "green") if decisions[-1]["accepted"] else Text("rejected", "red"),
            )
        )
    nominal = decisions[0]["document"]["figures"]["incumbent"]
    table(
        "",
        ["candidate", "artifact", "rollout", "one step", ""],
        [
            (
                "nominal (serving)",
                "",
                float(np.mean(nominal["rollout"])),
                float(np.mean(nominal["one_step"])),
                "baseline",
            ),
            *rows,
        ],
    )
    accepted = [d for d in decisions if d["accepted"]]
    return min(
        accepted,
        key=lambda d: float(np.mean(d["document"]["figures"]["candidate"]["rollout"])),
        default=None,
    )


def _promote_and_predict(client: Client, case: Case, decision: Decision) -> None:
    _heading(4, "Promote the best, and ask what serves")
    before = client.fetch(case.name, client.serving(case.name).artifact, case.work / "nominal")
    client.promote(case.name, decision["digest"], decision["generation"])
    serving = client.serving(case.name)
    show_serving([serving], as_json_=False)
    _heading(5, "Fetch what serves, verify it, predict held-out episodes with it")
    after = client.fetch(case.name, serving.artifact, case.work / "model")
    episodes = _held_out(client, case, load(after).predictor)
    _show_errors(case, load(before).predictor, load(after, serving.artifact).predictor, episodes)
    _heading(
        6, "A gate must be able to reject: judge the weaker candidate against the new incumbent"
    )
    weaker = client.version(case.name, 2)["digest"]
    judged = run_job(
        client, case.name, {"kind": "gate", "candidate": weaker, "gate": decision["gate"]}, "judge"
    )
    show_decision(
        client.decision(case.name, result_of(judged)["decision"]),
        client.gate_in_line(case.name, decision["gate"]),
    )


def _held_out(client: Client, case: Case, predictor: Predictor) -> list[Episode]:
    paths = []
    for record in client.episodes(case.name, role="validation"):
        paths.append(case.work / f"{record['digest'][:12]}.mcap")
        client.download_episode(case.name, record["digest"], paths[-1])
    return sorted(
        (read_episode(p.read_bytes(), predictor.plant.layout) for p in paths),
        key=lambda e: e.start_ns,
    )


def _show_errors(case: Case, before: Predictor, after: Predictor, episodes: list[Episode]) -> None:
    horizon_s = before.plant.horizon_s
    every = np.array([[rollout_rms(p, e, horizon_s) for e in episodes] for p in (before, after)])
    worst = int(np.argmax(every[0].mean(axis=0) / np.array(before.plant.scales)))
    channel, errors = before.plant.layout.observations[worst], every[:, :, worst].tolist()
    table(
        f"RMS of {channel.name} over windows of {horizon_s:g} s [m{channel.unit}]",
        ["held-out episode", "nominal", "serving", "less by"],
        [
            (e.digest[:12], 1e3 * b, 1e3 * a, f"{1 - a / b:.1%}")
            for e, b, a in zip(episodes, *errors, strict=True)
        ],
    )
    # the picture shows the episode that moves furthest
    most = int(np.argmax([np.ptp(e.observations[:, worst]) for e in episodes]))
    episode = episodes[most]
    traces = [
        Trace(
            name,
            predict_episode(p, episode, horizon_s)[:, worst],
            f"{1e3 * rms[most]:.2f} m{channel.unit}",
            colour,
        )
        for name, p, rms, colour in (
            ("nominal", before, errors[0], BEFORE),
            ("serving", after, errors[1], AFTER),
        )
    ]
    # the first window is left out: it starts where no past shows the velocity
    skip = int(np.searchsorted(episode.t_s, horizon_s))
    shown = [Trace(t.name, t.values[skip:], t.rms, t.colour) for t in traces]
    starts = episode.t_s[starts_every(episode.t_s, horizon_s)]
    subtitle = (
        f"held-out episode {episode.digest[:12]}, rollouts of {horizon_s:g} s; RMS errors "
        "over the whole episode in brackets"
    )
    name = case.name if len(before.plant.joints) == 1 else f"{case.name}, {channel.name}"
    svg = before_and_after(
        f"{name}: the same commands, before and after",
        subtitle,
        episode.t_s[skip:],
        episode.observations[skip:, worst],
        shown,
        starts[starts >= episode.t_s[skip]],
        channel.unit,
    )
    (case.work / "before-and-after.svg").write_text(svg)
    say("picture: {}", case.work / "before-and-after.svg")


def _roll_back(client: Client, case: Case) -> None:
    _heading(7, "Roll back: one call, tested before the pointer moves")
    serving = client.serving(case.name)
    began = time.monotonic()
    client.roll_back(case.name, serving.generation)
    say("switched in {:.0f} ms", 1e3 * (time.monotonic() - began))
    show_serving(list(client.history(case.name)), as_json_=False)


def _promote_again(client: Client, case: Case, decision: Decision) -> None:
    _heading(8, "Promote it again: a decision holds once, so it is judged against what serves now")
    request = {"kind": "gate", "candidate": decision["candidate"], "gate": decision["gate"]}
    judged = result_of(run_job(client, case.name, request, "judge"))["decision"]
    client.promote(case.name, judged, client.serving(case.name).generation)
    show_serving([client.serving(case.name)], as_json_=False)


def _audit(client: Client) -> None:
    _heading(9, "The audit trail, and its decisions recomputed from the recorded bytes")
    entries = list(client.audit())
    table(
        "",
        ["#", "what", "subject", "actor"],
        [(e["sequence"], e["kind"], e["subject"][:12], e["actor"]) for e in entries],
    )
    for entry in entries:
        if entry["kind"] == "decision:made":
            recorded = entry["facts"]["decision"]
            with (
                progress(f"replay {entry['subject'][:12]}") as bar,
                tempfile.TemporaryDirectory() as folder,
            ):
                recomputed = recompute(client, str(entry["plant"]), recorded, Path(folder), bar)
            say(
                "{} [red]disagrees[/]"
                if differences(recorded, recomputed)
                else "{} [green]agrees[/]",
                entry["subject"][:12],
            )
