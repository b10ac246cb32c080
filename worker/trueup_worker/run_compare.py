"""Run a comparison of two versions on the same recordings, as numbers to draw.

A comparison on one recording also leaves an MCAP with both predictions.
"""

from __future__ import annotations

from io import BytesIO
from typing import Any

from trueup.canonical import Json, canonical_bytes
from trueup.diagnose.regions import regions_of_samples
from trueup.diagnose.side_by_side import COMPARISON_FILE, side_by_side
from trueup.diagnose.traces import predicted
from trueup.episode.overlay import write_overlay
from trueup.episode.role import Role
from trueup_service.actions import find
from trueup_service.registry.records import JobRecord
from trueup_service.registry.transaction import reading
from trueup_service.wiring import Parts
from trueup_worker.inputs import read_episodes, read_plant, read_predictor
from trueup_worker.outputs import keep_file, leave_files
from trueup_worker.progress import Progress

OVERLAY_FILE = "overlay.mcap"

effects = leave_files


def compute(parts: Parts, job: JobRecord, progress: Progress) -> dict[str, Json]:
    """Compares. Repeating it gives the same bytes."""
    request: dict[str, Any] = job.request
    plant = read_plant(parts, job)
    first, second = (read_predictor(parts, job, request[which]) for which in ("first", "second"))
    episodes = read_episodes(
        parts, job, plant, tuple(Role), progress.stage("reading episodes", 0.0, 0.3)
    )
    progress.stage("rolling out", 0.3, 0.8)(0.0)
    compared = side_by_side(first, second, episodes)
    files = [keep_file(parts, COMPARISON_FILE, "application/json", canonical_bytes(compared))]
    if len(episodes) == 1:
        progress.stage("writing the overlay", 0.8, 1.0)(0.0)
        with reading(parts.database) as tx:
            names = {
                f"v{find.artifact(tx, job.plant, request[which]).version}": which
                for which in ("first", "second")
            }
        models = {"first": first, "second": second}
        predictions = {name: predicted(models[which], episodes[0]) for name, which in names.items()}
        written = BytesIO()
        write_overlay(
            written,
            parts.blobs.get(episodes[0].digest),
            episodes[0],
            predictions,
            regions_of_samples(plant, episodes[0]),
        )
        files.append(keep_file(parts, OVERLAY_FILE, "application/vnd.mcap", written.getvalue()))
    return {"files": list(files), "by_episode": compared["by_episode"]}


def result(outcome: dict[str, Any]) -> dict[str, Json]:
    """Returns the result of the job."""
    return {"by_episode": outcome["by_episode"]}
