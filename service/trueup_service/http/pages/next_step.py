"""The next step of a plant on the way from recordings to a correction that serves: what to do, why,
and the form or the page that does it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from trueup.canonical import Json
from trueup_pages.copy_as import command, rest
from trueup_pages.jobs import name_of
from trueup_service.actor_context import END_OF_TIME
from trueup_service.registry.records import DecisionRecord, JobRecord, Move, Role
from trueup_service.registry.transaction import ReadTransaction

SOUGHT = 50  # of the newest decisions
REQUIRED = ("adaptation", "validation")  # roles without which nothing is diagnosed


@dataclass(frozen=True, slots=True)
class NextStep:
    """One step: `what` to do and `why`. A `button` sends `fields` to `to`, or is a link there where
    there are no fields; `role` may press it. `command` and `rest` do the same."""

    what: str
    why: str
    button: str = ""
    to: str = ""
    fields: Mapping[str, str] = field(default_factory=dict)
    role: str = Role.ENGINEER
    command: str = ""
    rest: str = ""


def next_step(tx: ReadTransaction, plant: str, serving: Move) -> NextStep:
    """The next step of a plant."""
    here, api = f"/plants/{plant}", f"/v1/plants/{plant}"
    under_way = [
        j for j in tx.jobs.under_way() if j.plant == plant and j.kind in ("diagnose", "fit", "gate")
    ]
    if under_way:
        job = under_way[0]
        return NextStep(
            f"A {name_of(job.kind)} is under way",
            "Its page shows how far it is, and goes on by itself.",
            "Look",
            f"{here}/jobs/{job.id}",
            command=command("jobs", plant),
            rest=rest("GET", f"/v1/jobs/{job.id}"),
        )
    newest = {role: tx.episodes.newest_of_role(plant, role) for role in REQUIRED}
    missing = [role for role, at in newest.items() if at is None]
    if missing:
        return NextStep(
            "Upload recordings",
            f"There is no {' and no '.join(missing)} episode yet: models are fitted on adaptation "
            "episodes, and compared on validation episodes.",
            "Upload…",
            f"{here}/upload",
            command=command("upload", plant, "FILES", "--role", missing[0]),
        )
    if not tx.gates.in_order(plant):
        return _declare_gate(plant)
    diagnosis = tx.jobs.last_succeeded(plant, "diagnose")
    if diagnosis is None or diagnosis.created_at < max(at for at in newest.values() if at):
        return NextStep(
            "Diagnose the gap",
            "Recordings were added since the last diagnosis."
            if diagnosis
            else "Find where the declared model is wrong, and which effect causes it.",
            "Diagnose",
            f"{here}/jobs",
            {"kind": "diagnose"},
            command=command("diagnosis", plant),
            rest=rest("POST", f"{api}/jobs", {"kind": "diagnose"}),
        )
    return step_after(tx, plant, serving, diagnosis)


def step_after(tx: ReadTransaction, plant: str, serving: Move, diagnosis: JobRecord) -> NextStep:
    """The step that follows from a diagnosis: judge its model, promote it, or watch it."""
    here = f"/plants/{plant}"
    result: Any = diagnosis.result
    if result["report"]["verdict"] == "no_gap":
        return NextStep(
            "Nothing has to be corrected",
            "The declared model predicts to the noise floor on the held-out recordings. Watch it, "
            "to be told when that changes.",
            "Watch it…",
            f"{here}/monitor",
        )
    candidate = tx.artifacts.get(plant, result["artifact"])
    if candidate is None:
        return _watch(tx, plant, serving)
    if serving.artifact == candidate.digest:
        return _watch(tx, plant, serving)
    decision = _decision_on(tx, plant, candidate.digest, serving.generation)
    if decision is None:
        return judge(tx, plant, candidate.digest, candidate.version)
    if not decision.accepted:
        return NextStep(
            f"Version {candidate.version} was rejected",
            "The gate refuses the corrected model. The decision shows each figure beside its "
            "threshold.",
            "Read the decision",
            f"{here}/decisions/{decision.digest}",
        )
    return NextStep(
        f"Promote version {candidate.version}",
        f"The gate accepted the corrected model. It serves once somebody promotes it; version "
        f"{serving.version} serves now.",
        "Promote…",
        f"{here}/decisions/{decision.digest}",
        role=Role.OPERATOR,
        command=command("promote", plant, decision.digest[:12]),
        rest=rest("POST", f"/v1{here}/serving/promote", _promotion(decision)),
    )


def _declare_gate(plant: str) -> NextStep:
    return NextStep(
        "Declare a gate",
        "The gate is the rule by which a corrected model is accepted or rejected. It is "
        "declared before anything is scored, and frozen.",
        "Declare the default gate",
        f"/plants/{plant}/gate",
        {"default": "yes"},
        rest=rest("POST", f"/v1/plants/{plant}/gates"),
    )


def judge(tx: ReadTransaction, plant: str, candidate: str, version: int) -> NextStep:
    """Judge a version by the gate in force."""
    line = tx.gates.in_order(plant)
    if not line:
        return _declare_gate(plant)
    asked: dict[str, str] = {"kind": "gate", "candidate": candidate, "gate": line[-1].digest}
    return NextStep(
        f"Judge version {version}, the corrected model",
        "The gate, a rule that was declared before, compares it with the model that serves, on "
        "held-out recordings, and accepts or rejects it.",
        "Judge",
        f"/plants/{plant}/jobs",
        asked,
        command=command("gate", plant, candidate[:12]),
        rest=rest("POST", f"/v1/plants/{plant}/jobs", asked),
    )


def _watch(tx: ReadTransaction, plant: str, serving: Move) -> NextStep:
    watching = tx.watches.current(plant)
    monitor = None if watching is None else tx.monitors.get(plant, watching.monitor)
    if monitor is not None and monitor.artifact == serving.artifact:
        return NextStep(
            f"Version {serving.version} serves and is watched",
            "A monitor compares each new recording with healthy operation.",
            "Look at the monitor",
            f"/plants/{plant}/monitor",
        )
    return NextStep(
        f"Version {serving.version} serves: watch it",
        "A monitor tells when the machine no longer is as the model says. It is calibrated on "
        "recordings of healthy operation, of the role reference.",
        "Calibrate a monitor…",
        f"/plants/{plant}/monitor",
        command=command("calibrate", plant),
    )


def _decision_on(
    tx: ReadTransaction, plant: str, candidate: str, generation: int
) -> DecisionRecord | None:
    """The newest decision on a candidate against what serves now."""
    return next(
        (
            d
            for d in tx.decisions.page(plant, END_OF_TIME, SOUGHT)
            if d.candidate == candidate and d.generation == generation
        ),
        None,
    )


def _promotion(decision: DecisionRecord) -> dict[str, Json]:
    return {"decision": decision.digest, "expected_generation": decision.generation}
