"""Run the plant's monitor over new episodes, in the order of their start.

If it alarms, the alarm says what changed.

Following is repeatable. Its outcome is stored only if the monitor still stands where the job began,
so that of two such jobs at once one does nothing.
"""

from __future__ import annotations

import uuid
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from trueup.canonical import Json
from trueup.episode.mcap import read_episode
from trueup.episode.role import WATCHED
from trueup.errors import BadEpisode
from trueup.monitor.change import Before, changed, onset
from trueup.monitor.monitor import Monitor
from trueup_service.actions import find
from trueup_service.actions.record_watch import Followed, record_watch
from trueup_service.actor_context import ActorContext
from trueup_service.registry.blobs import BlobMissing
from trueup_service.registry.records import EpisodeRecord, JobRecord, Watch, Watching
from trueup_service.registry.transaction import Transaction, reading, writing
from trueup_service.wiring import Parts
from trueup_worker.cycle import cycle_of
from trueup_worker.inputs import read_plant, read_predictor
from trueup_worker.progress import Progress

AT_ONCE = 200  # episodes in one job; another follows if there are more
HISTORY = 1000  # episodes before an alarm in which the onset of the change is sought


def compute(parts: Parts, job: JobRecord, progress: Progress) -> dict[str, Json]:
    """Follows the episodes that the monitor has not seen."""
    with reading(parts.database) as tx:
        watching = tx.watches.current(job.plant)
        if watching is None or watching.monitor != job.request["monitor"]:
            return {
                "monitor": job.request["monitor"],
                "from": None,
                "seen": [],
                "kept": {},
                "alarm": None,
            }
        monitor = Monitor.from_document(find.monitor(tx, job.plant, watching.monitor).document)
        waiting = tx.episodes.unwatched(watching, WATCHED, AT_ONCE)
        history = tx.watches.page(
            job.plant, watching.monitor, max(watching.sequence - HISTORY, 0), HISTORY
        )
    with writing(parts.database) as tx:
        tx.jobs.add_reads(job.id, [e.digest for e in waiting], job.kind)
    plant, predictor = read_plant(parts, job), read_predictor(parts, job, monitor.artifact)
    channels = [c.name for c in plant.layout.observations]
    states: Mapping[str, Sequence[float]] = watching.kept  # type: ignore[assignment]
    seen: list[dict[str, Any]] = []
    alarm: dict[str, Any] | None = None
    rows = [(w.episode, w.seen) for w in history if "channels" in w.seen]
    progress.stage("following episodes", 0.0, 1.0)
    for record in waiting:
        try:
            episode = read_episode(parts.blobs.get(record.digest), plant.layout)
            states, followed = monitor.follow(states, predictor, episode)
        except (BadEpisode, BlobMissing) as error:  # recorded; the others are still followed
            failure = {"not_followed": error.message, "seconds": 0.0, "alarms": {}}
            seen.append({"episode": record.digest, "seen": failure})
            continue
        document = followed.document(channels)
        rows.append((record.digest, document))
        seen.append({"episode": record.digest, "seen": document})
        if followed.alarms and alarm is None:
            alarm = _alarm(parts, job.plant, monitor, channels, rows, record, document)
        progress(len(seen) / len(waiting))
    return {
        "monitor": watching.monitor,
        "from": watching.sequence,
        "since": watching.since,
        "seen": seen,
        "kept": {name: list(state) for name, state in states.items()},
        "alarm": alarm,
    }


def _alarm(
    parts: Parts,
    plant: str,
    monitor: Monitor,
    channels: Sequence[str],
    rows: Sequence[tuple[str, Mapping[str, Any]]],
    at: EpisodeRecord,
    document: Mapping[str, Any],
) -> dict[str, Any]:
    """Returns an alarm: which detectors, since which episode, and what is different since then."""
    rms = np.array([[seen["channels"][c]["rms"] for c in channels] for _, seen in rows])
    first = onset(rms, monitor.usual)
    with reading(parts.database) as tx:
        episodes = [find.episode(tx, plant, digest) for digest, _ in rows[first:]]
    now = Before.of_summaries([e.summary for e in episodes])
    change = changed(monitor.before, {c: rms[first:, i] for i, c in enumerate(channels)}, now)
    alarm: dict[str, Json] = {
        "detectors": document["alarms"],
        "since": episodes[0].digest,
        "since_ns": str(episodes[0].start_ns),
        "episodes": len(episodes),
        "change": change,
    }
    return {"episode": at.digest, "document": alarm}


def effects(
    parts: Parts, tx: Transaction, job: JobRecord, outcome: dict[str, Any], context: ActorContext
) -> None:
    """Moves the monitor on, raises the alarm, and submits the job that follows."""
    if outcome["from"] is not None:
        before = Watching(
            plant=job.plant,
            monitor=outcome["monitor"],
            since=outcome["since"],
            sequence=outcome["from"],
            kept={},
        )
        seen = [
            Watch(
                plant=job.plant,
                monitor=before.monitor,
                sequence=before.sequence + 1 + i,
                episode=s["episode"],
                seen=s["seen"],
                at=context.now,
            )
            for i, s in enumerate(outcome["seen"])
        ]
        followed = Followed(before, outcome["kept"], seen, outcome["alarm"])
        record_watch(tx, followed, uuid.uuid4().hex, context)
    cycle_of(parts, tx, context).go_on(job.plant)


def result(outcome: dict[str, Any]) -> dict[str, Json]:
    """Returns the result of the job."""
    return {
        "monitor": outcome["monitor"],
        "episodes": len(outcome["seen"]),
        "alarm": outcome["alarm"] is not None,
    }
