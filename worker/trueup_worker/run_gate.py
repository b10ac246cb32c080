"""Run a gate: it scores the candidate and the incumbent on held-out episodes and applies the frozen
rules."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from typing import Any

from trueup.canonical import Json, digest_of
from trueup.control.closed_loop import Driven, drive
from trueup.episode.episode import Episode
from trueup.episode.role import HELD_OUT
from trueup.gate.decision import Gate
from trueup.gate.evidence import Evidence
from trueup.gate.judge import closed_loop, judge, run_trial, sensitivity
from trueup.gate.rule import rules
from trueup.model.predictor import Predictor
from trueup_service.actions import find
from trueup_service.actions.add_evidence import add_evidence
from trueup_service.actions.gate_line import known_at
from trueup_service.actions.record_decision import record_decision
from trueup_service.actions.switchback import rehearse
from trueup_service.actor_context import ActorContext, time_text
from trueup_service.registry.records import JobRecord
from trueup_service.registry.transaction import Transaction, reading
from trueup_service.wiring import Parts
from trueup_worker.cycle import cycle_of
from trueup_worker.exact_numbers import from_json, to_json
from trueup_worker.inputs import read_episodes, read_plant, read_predictor
from trueup_worker.progress import Progress
from trueup_worker.spread import Spread

CANDIDATE, INCUMBENT = "candidate", "incumbent"


def compute(parts: Parts, job: JobRecord, progress: Progress) -> dict[str, Json]:
    """Scores the candidate and the incumbent, and judges the candidate. Where the gate asks for
    closed-loop runs, those of each model are a part of the job."""
    request: dict[str, Any] = job.request
    plant = read_plant(parts, job)
    with reading(parts.database) as tx:
        declared = find.gate(tx, job.plant, request["gate"])
        known = request.get("known") or known_at(
            tx, job.plant, declared, request["candidate"], request["episodes"]
        )
    gate = Gate.from_document(declared.document)
    candidate, incumbent, copy = (
        read_predictor(parts, job, request[which])
        for which in ("candidate", "incumbent", "incumbent")
    )
    episodes = read_episodes(
        parts, job, plant, HELD_OUT, progress.stage("reading episodes", 0.0, 0.4)
    )
    others = (
        {digest: read_predictor(parts, job, digest) for digest in request["beside"]}
        if "beside" in request
        else None
    )
    run = run_trial(
        gate,
        candidate,
        incumbent,
        episodes,
        progress.stage("scoring", 0.4, 1.0),
        copy,
        others,
        lambda report: _drive_both(parts, job, report),
    )
    decision = judge(
        gate,
        run.trial,
        plant=plant.digest,
        controls=run.controls,
        beside=run.beside,
        known=known,
        uses=request.get("uses", ()),
        selection=request.get("selection"),
        candidate=request["candidate"],
        incumbent=request["incumbent"],
        generation=request["generation"],
    )
    outcome: dict[str, Json] = {
        "decision": decision.document(),
        "rehearsed": _rehearse(parts, job, episodes, gate, candidate) if decision.accepted else {},
    }
    if not request.get("scales"):
        return outcome
    return {
        **outcome,
        "scales": sensitivity(gate, run, plant.scales, [c.name for c in plant.layout.observations]),
    }


def part(parts: Parts, job: JobRecord, asked: dict[str, Any]) -> Json:
    """Runs one model in closed loop."""
    request: dict[str, Any] = job.request
    models = {which: read_predictor(parts, job, request[which]) for which in (CANDIDATE, INCUMBENT)}
    episodes = read_episodes(parts, job, read_plant(parts, job), HELD_OUT, lambda _: None)
    machine, courses = closed_loop(models[CANDIDATE], models[INCUMBENT], episodes)
    driven = drive(machine, models[asked["model"]], courses)
    return {"errors": to_json(driven.errors), "breaches": to_json(driven.breaches)}


def _drive_both(
    parts: Parts, job: JobRecord, progress: Callable[[float], None]
) -> tuple[Driven, Driven]:
    with Spread(parts.queue, job.id) as spread:
        candidate, incumbent = (
            Driven(from_json(answer["errors"]), from_json(answer["breaches"]))
            for answer in spread([{"model": which} for which in (CANDIDATE, INCUMBENT)], progress)
        )
    return candidate, incumbent


def _rehearse(
    parts: Parts, job: JobRecord, episodes: Sequence[Episode], gate: Gate, candidate: Predictor
) -> dict[str, Json]:
    """Tries the switch back to the incumbent, before anything is promoted."""
    request: dict[str, Any] = job.request
    with reading(parts.database) as tx:
        back, registered = (
            find.artifact(tx, job.plant, request["incumbent"]),
            find.plant_digest(tx, job.plant),
        )
    return rehearse(
        parts.blobs,
        back,
        registered,
        candidate,
        episodes[0],
        gate.scoring,
        time_text(datetime.now(UTC)),
    )


def effects(
    parts: Parts, tx: Transaction, job: JobRecord, outcome: dict[str, Any], context: ActorContext
) -> None:
    """Records the decision, and promotes its candidate if a policy says so."""
    decision = record_decision(
        tx, job.plant, outcome["decision"], job.id, context, outcome["rehearsed"]
    )
    closed_loop: Any = outcome["decision"]["figures"].get("closed_loop")
    if closed_loop is not None:
        add_evidence(tx, job.plant, _evidence(outcome["decision"], closed_loop), job.id, context)
    cycle_of(parts, tx, context).judged(job, decision, outcome["rehearsed"])


def _evidence(decision: dict[str, Any], closed_loop: dict[str, Any]) -> dict[str, Any]:
    """Returns the runs in closed loop as evidence: passed if no rule on them refused."""
    judged = [v["passed"] for v in decision["verdicts"] if rules()[v["rule"]].closed_loop]
    figures = {k: v for k, v in closed_loop.items() if k not in ("stage", "shows", "cannot_show")}
    return Evidence(
        decision["candidate"],
        closed_loop["stage"],
        all(judged),
        closed_loop["shows"],
        closed_loop["cannot_show"],
        {**figures, "decision": digest_of(decision), "against": decision["incumbent"]},
    ).document()


def result(outcome: dict[str, Any]) -> dict[str, Json]:
    """Returns the result of the job."""
    scales = {"scales": outcome["scales"]} if "scales" in outcome else {}
    return {
        "decision": digest_of(outcome["decision"]),
        "accepted": outcome["decision"]["accepted"],
        **scales,
    }
