"""Continue the cycle, as far as the plant's policy lets it go without a person.

    an alarm is open       diagnose what was recorded since the change began; again once twice as
                           much has been, if that led nowhere
    a diagnosis ended      judge the corrected model by the policy's gate
    a candidate passed     promote it, and close the alarm
    the pointer moved      once enough healthy episodes came in, calibrate a monitor of what serves
                           now

Each step is asked for in the transaction of the one before, so that none is lost and none happens
twice. Without a policy an alarm opens a diagnosis, and the rest is a person's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from trueup.canonical import Json
from trueup.episode.role import HEALTHY, HELD_OUT, Role
from trueup.errors import TrueupError
from trueup.gate.line import budget_of
from trueup.gate.policy import ASK, UpdatePolicy
from trueup_service.actions import find
from trueup_service.actions.alarms import close_alarm, follow_alarm
from trueup_service.actions.declare_policy import policy_of
from trueup_service.actions.move_pointer import promote_decision
from trueup_service.actions.submission import Submission, only_safeguarded
from trueup_service.actions.submit_job import submit_calibration, submit_diagnosis, submit_watch
from trueup_service.actions.submit_trial import submit_gate
from trueup_service.actor_context import ActorContext
from trueup_service.jobs import JobQueue
from trueup_service.registry.records import (
    FINAL,
    AlarmRecord,
    DecisionRecord,
    EpisodeRecord,
    JobRecord,
    JobState,
    Move,
    MoveKind,
)
from trueup_service.registry.transaction import Transaction

DIAGNOSED = {Role.ADAPTATION, Role.VALIDATION}
AGAIN = 2  # a diagnosis is repeated with this many times the episodes of one that led nowhere
NOTHING = "no_gap"


@dataclass(frozen=True, slots=True)
class Cycle:
    """The steps of the cycle, with what they need: the transaction, the queue, new ids, and who
    acts when."""

    tx: Transaction
    queue: JobQueue
    new: Callable[[], str]
    context: ActorContext

    def _submission(self, job: str, plant: str, request: dict[str, Json]) -> Submission:
        return Submission(self.tx, self.queue, job, plant, request, self.context)

    def go_on(self, plant: str) -> None:
        """Take the next step after an episode came in, or after a monitor was calibrated or has
        looked at episodes."""
        self.tx.plants.lock(plant)
        self._watch(plant)
        alarm = self.tx.alarms.open(plant)
        policy = policy_of(self.tx, plant)
        if alarm is not None and (policy is None or policy.on_alarm != ASK):
            self._diagnose(alarm, policy)

    def diagnosed(self, job: JobRecord, candidate: str, verdict: str) -> None:
        """After a diagnosis: judge its model, if the open alarm asked for the diagnosis and the
        policy allows it."""
        self.tx.plants.lock(job.plant)
        alarm, policy = self.tx.alarms.open(job.plant), policy_of(self.tx, job.plant)
        if (
            alarm is None
            or alarm.job != job.id
            or policy is None
            or policy.on_diagnosis == ASK
            or verdict == NOTHING
        ):
            return
        episodes: list[Json] = list(self._held_out(job, alarm, policy))
        request: dict[str, Json] = {
            "candidate": candidate,
            "gate": policy.gate,
            "episodes": episodes,
        }
        trial = self.new()
        if self._tried(
            job.plant,
            lambda: submit_gate(self._submission(trial, job.plant, request)),
        ):
            follow_alarm(self.tx, alarm, self.context, trial=trial)

    def judged(self, job: JobRecord, decision: DecisionRecord, rehearsed: dict[str, Json]) -> None:
        """After a trial: promote its candidate, if the cycle asked for this trial and the gate is
        that of the policy in force."""
        plant = decision.plant
        self.tx.plants.lock(plant)
        alarm, policy = self.tx.alarms.open(plant), policy_of(self.tx, plant)
        if alarm is None or alarm.trial != job.id or policy is None or policy.on_acceptance == ASK:
            return
        if (
            not decision.accepted
            or decision.gate != policy.gate
            or find.serving(self.tx, plant).generation != decision.generation
        ):
            return
        self._tried(
            plant,
            lambda: self.moved(
                promote_decision(
                    self.tx, plant, decision.digest, decision.generation, rehearsed, self.context
                )
            ),
        )

    def moved(self, move: Move) -> None:
        """After a move of the pointer: close the open alarm, which was about the model that served
        before."""
        alarm = self.tx.alarms.open(move.plant)
        if alarm is not None:
            because = (
                f"{move.kind}: version {move.version} serves from generation {move.generation} on"
            )
            close_alarm(self.tx, move.plant, alarm.id, because, self.context)

    def _watch(self, plant: str) -> None:
        """Let the monitor of the model that serves look at new episodes. Where there is none,
        calibrate one if the policy wants it and there are enough healthy episodes.

        Healthy for a new model are the episodes that came in since it serves and by which it was
        neither fitted nor judged. After a rollback a person decides what is healthy, since the
        change may still be there.
        """
        now, watching = find.serving(self.tx, plant), self.tx.watches.current(plant)
        if (
            watching is not None
            and find.monitor(self.tx, plant, watching.monitor).artifact == now.artifact
        ):
            submit_watch(self._submission(self.new(), plant, {}))
            return
        policy, last = policy_of(self.tx, plant), self.tx.jobs.last(plant, "calibrate")
        if (
            policy is None
            or now.kind != MoveKind.PROMOTED
            or (last is not None and last.state not in FINAL)
        ):
            return
        judged: Any = (
            []
            if now.decision is None
            else find.decision(self.tx, plant, now.decision).document["episodes"]
        )
        healthy = [
            e.digest
            for e in self.tx.episodes.of_roles(plant, HEALTHY, ingested_after=now.at)
            if e.digest not in judged
        ]
        tried: Any = (
            []
            if last is None or last.request.get("artifact") != now.artifact
            else last.request["episodes"]
        )
        if len(healthy) >= max(policy.reference_episodes, AGAIN * len(tried)):
            request: dict[str, Json] = {
                "promise_h": policy.promise_h,
                "seed": 0,
                "episodes": list(healthy),
            }
            self._tried(
                plant,
                lambda: submit_calibration(self._submission(self.new(), plant, request)),
            )

    def _diagnose(self, alarm: AlarmRecord, policy: UpdatePolicy | None) -> None:
        """Diagnose the episodes recorded since the change began: at once, and again when there are
        AGAIN times as many."""
        recorded = self.tx.episodes.of_roles(alarm.plant, DIAGNOSED, _since_ns(alarm))
        episodes = only_safeguarded(policy, recorded)
        if {e.role for e in episodes} != DIAGNOSED or not self._is_due(
            alarm, policy, len(episodes)
        ):
            return
        request: dict[str, Json] = {"episodes": [e.digest for e in episodes], "seed": 0}
        job = submit_diagnosis(self._submission(self.new(), alarm.plant, request))
        follow_alarm(self.tx, alarm, self.context, job=job.id, trial=None)

    def _is_due(self, alarm: AlarmRecord, policy: UpdatePolicy | None, episodes: int) -> bool:
        """Whether there was no diagnosis yet, or one that led nowhere and there are AGAIN times as
        many episodes now."""
        if alarm.job is None:
            return True
        job = find.job(self.tx, alarm.job)
        trial = None if alarm.trial is None else find.job(self.tx, alarm.trial)
        if job.state not in FINAL or (trial is not None and trial.state not in FINAL):
            return False
        result: Any = job.result or {}
        judged: Any = {} if trial is None else trial.result or {}
        found_nothing = job.state != JobState.SUCCEEDED or result["report"]["verdict"] == NOTHING
        led_nowhere = (
            policy is not None and policy.on_diagnosis != ASK and not judged.get("accepted")
        )
        return (found_nothing or led_nowhere) and episodes >= AGAIN * len(job.request["episodes"])  # type: ignore[arg-type]

    def _held_out(
        self, diagnosis: JobRecord, alarm: AlarmRecord, policy: UpdatePolicy
    ) -> list[str]:
        """The held-out episodes to judge on: in each cell of the gate's conditions those recorded
        since the change, or all of the cell where there are none.

        Episodes on which the diagnosis has not compared are preferred, and spent ones are left out.
        """
        gate: Any = find.gate(self.tx, alarm.plant, policy.gate).document
        cells: dict[tuple[str, ...], list[EpisodeRecord]] = {}
        for episode in only_safeguarded(policy, self.tx.episodes.of_roles(alarm.plant, HELD_OUT)):
            if self.tx.jobs.count_uses(episode.digest, "gate") >= budget_of(gate):
                continue
            declared: Any = episode.summary["conditions"]
            cells.setdefault(
                tuple(declared.get(name, "") for name in gate.get("conditions", [])), []
            ).append(episode)
        chosen: list[str] = []
        for inside in cells.values():
            new = [e for e in inside if e.start_ns >= _since_ns(alarm)] or inside
            unseen = [e for e in new if e.digest not in diagnosis.request["episodes"]]  # type: ignore[operator]
            chosen += [e.digest for e in unseen or new]
        return chosen

    def _tried(self, plant: str, act: Callable[[], object]) -> bool:
        """Take a step, and say whether it succeeded. Where it fails the log says why, and the cycle
        waits for a person or for more data."""
        try:
            act()
        except TrueupError as error:
            self.tx.log.append(
                self.context,
                "cycle:halted",
                plant=plant,
                subject=error.code,
                facts={"because": error.message},
            )
            return False
        return True


def _since_ns(alarm: AlarmRecord) -> int:
    """The time at which the change began [ns]."""
    document: Any = alarm.document
    return int(document["since_ns"])
