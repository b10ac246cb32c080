"""Continue the cycle, as far as the plant's policy lets it go without a person.

    an alarm is open       diagnose what was recorded since the change began; again once twice as much has been, if nothing was found
    a diagnosis ended      judge the corrected model by the policy's gate
    a candidate passed     promote it, and close the alarm
    the pointer moved      once enough healthy episodes came in, calibrate a monitor of what serves now

Each step is asked for in the transaction of the one before, so that none is lost and none happens twice. Without a policy an alarm opens a
diagnosis, and the rest is a person's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from trueup.canonical import Json
from trueup.episode.role import HEALTHY, HELD_OUT, Role
from trueup.errors import TrueupError
from trueup.gate.policy import ASK, UpdatePolicy
from trueup_service.actions import find
from trueup_service.actions.alarms import close_alarm
from trueup_service.actions.declare_policy import policy_of
from trueup_service.actions.move_pointer import promote_decision
from trueup_service.actions.stamp import Stamp
from trueup_service.actions.submit_job import submit_calibration, submit_diagnosis, submit_gate, submit_watch
from trueup_service.jobs import JobQueue
from trueup_service.registry.records import FINAL, AlarmRecord, DecisionRecord, EpisodeRecord, JobRecord, JobState, Move
from trueup_service.registry.store import Writer

DIAGNOSED = {Role.ADAPTATION, Role.VALIDATION}
AGAIN = 2  # times the episodes of a diagnosis that found nothing, before there is another
NOTHING = "no_gap"


@dataclass(frozen=True, slots=True)
class Cycle:
    """What a step needs: the transaction, the queue, new ids, and who acts when."""

    writer: Writer
    queue: JobQueue
    new: Callable[[], str]
    stamp: Stamp

    def go_on(self, plant: str) -> None:
        """Do what is next after an episode came in or a monitor looked at some."""
        self._watch(plant)
        alarm = self.writer.open_alarm(plant)
        policy = policy_of(self.writer, plant)
        if alarm is not None and (policy is None or policy.on_alarm != ASK):
            self._diagnose(alarm)

    def diagnosed(self, job: JobRecord, candidate: str, verdict: str) -> None:
        """A diagnosis ended: judge its model, if the open alarm asked for it and the policy says so."""
        alarm, policy = self._asked(job.plant, job.id)
        if alarm is None or policy is None or policy.on_diagnosis == ASK or verdict == NOTHING:
            return
        request: dict[str, Json] = {"candidate": candidate, "gate": policy.gate, "episodes": self._held_out(job.plant, alarm, policy)}
        self._submitted(job.plant, lambda: submit_gate(self.writer, self.queue, self.new(), job.plant, request, self.stamp))

    def judged(self, decision: DecisionRecord, rehearsed: dict[str, Json]) -> None:
        """A decision was made: promote its candidate, if the open alarm's diagnosis made it and the policy says so."""
        plant, alarm = decision.plant, self.writer.open_alarm(decision.plant)
        policy = policy_of(self.writer, plant)
        if alarm is None or alarm.job is None or policy is None or policy.on_acceptance == ASK or not decision.accepted:
            return
        result: Any = find.job(self.writer, alarm.job).result or {}
        if result.get("artifact") != decision.candidate or find.serving(self.writer, plant).generation != decision.generation:
            return
        move = promote_decision(self.writer, plant, decision.digest, decision.generation, rehearsed, self.stamp)
        self.moved(move)
        self._watch(plant)

    def moved(self, move: Move) -> None:
        """Another model serves: the alarm was about the one before it."""
        alarm = self.writer.open_alarm(move.plant)
        if alarm is not None:
            because = f"{move.kind}: version {move.version} serves from generation {move.generation} on"
            close_alarm(self.writer, move.plant, alarm.id, because, self.stamp)

    def _watch(self, plant: str) -> None:
        """Let the monitor of what serves look at what is new; make one where the policy wants it and there is what it takes."""
        serving, watching = find.serving(self.writer, plant).artifact, self.writer.watching(plant)
        if watching is None or find.monitor(self.writer, plant, watching.monitor).artifact == serving:
            submit_watch(self.writer, self.queue, self.new(), plant, self.stamp)
            return
        policy, last = policy_of(self.writer, plant), self.writer.last_job(plant, "calibrate")
        changes = [a for a in self.writer.alarms(plant, self.stamp.now + "~", 1) if a.closed_at is not None]
        if policy is None or not changes or (last is not None and last.state not in FINAL):
            return
        healthy = _since(self.writer.episodes_of_role(plant, HEALTHY), changes[0])
        tried: Any = [] if last is None or last.request.get("artifact") != serving else last.request["episodes"]
        if len(healthy) >= max(policy.reference_episodes, AGAIN * len(tried)):
            request: dict[str, Json] = {"promise_h": policy.promise_h, "seed": 0, "episodes": [e.digest for e in healthy]}
            self._submitted(plant, lambda: submit_calibration(self.writer, self.queue, self.new(), plant, request, self.stamp))

    def _diagnose(self, alarm: AlarmRecord) -> None:
        """Diagnose what was recorded since the change began: at once, or again when there is twice as much."""
        found = _since(self.writer.episodes_of_role(alarm.plant, DIAGNOSED), alarm)
        if {e.role for e in found} != DIAGNOSED:
            return
        if alarm.job is not None:
            job = find.job(self.writer, alarm.job)
            result: Any = job.result or {}
            before: Any = job.request["episodes"]
            nothing = job.state != JobState.SUCCEEDED or result["report"]["verdict"] == NOTHING
            if job.state not in FINAL or not nothing or len(found) < AGAIN * len(before):
                return
        request: dict[str, Json] = {"episodes": [e.digest for e in found], "seed": 0}
        job = submit_diagnosis(self.writer, self.queue, self.new(), alarm.plant, request, self.stamp)
        self.writer.update_alarm(alarm.id, job=job.id)

    def _asked(self, plant: str, job: str) -> tuple[AlarmRecord | None, UpdatePolicy | None]:
        alarm = self.writer.open_alarm(plant)
        return (alarm if alarm is not None and alarm.job == job else None), policy_of(self.writer, plant)

    def _held_out(self, plant: str, alarm: AlarmRecord, policy: UpdatePolicy) -> list[Json]:
        """Of each cell of the gate's conditions what was recorded since the change; of a cell that was not visited since, what there is."""
        conditions: Any = find.gate(self.writer, plant, policy.gate).document.get("conditions", [])
        cells: dict[tuple[str, ...], list[EpisodeRecord]] = {}
        for episode in self.writer.episodes_of_role(plant, HELD_OUT):
            declared: Any = episode.summary["conditions"]
            cells.setdefault(tuple(declared.get(name, "") for name in conditions), []).append(episode)
        return [e.digest for inside in cells.values() for e in (_since(inside, alarm) or inside)]

    def _submitted(self, plant: str, submit: Callable[[], object]) -> None:
        """Ask for a job; where it cannot be, the log says why, and the cycle waits for a person or for more data."""
        try:
            submit()
        except TrueupError as error:
            self.writer.append_audit(
                at=self.stamp.now,
                kind="cycle:halted",
                actor=self.stamp.actor,
                plant=plant,
                subject=error.code,
                facts={"because": error.message},
            )


def _since(episodes: list[EpisodeRecord], alarm: AlarmRecord) -> list[EpisodeRecord]:
    """Those that were recorded since the change began."""
    document: Any = alarm.document
    return [e for e in episodes if e.start_ns >= int(document["since_ns"])]
