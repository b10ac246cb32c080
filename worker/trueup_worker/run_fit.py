"""Run a fit: episodes become a candidate artifact with its provenance."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from trueup.artifact.artifact import Artifact, pack
from trueup.canonical import Json, digest_of, digest_of_bytes
from trueup.code_identity import code_identity
from trueup.collect.coverage import coverage_of
from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.fit.identify import identify
from trueup.fit.randomised import pooled
from trueup.fit.residual import RIDGE, fit_residual
from trueup.model.plant import Plant
from trueup.model.predictor import Predictor
from trueup.randomise.randomisation import Randomisation
from trueup.randomise.study import CONFIGURATION, Context, Randomised, fit_family
from trueup_service.actions.add_artifact import add_artifact
from trueup_service.actor_context import ActorContext
from trueup_service.registry.records import JobRecord
from trueup_service.registry.transaction import Transaction
from trueup_service.wiring import Parts
from trueup_worker.inputs import context_of, read_episodes, read_plant, sources
from trueup_worker.outputs import keep_arrays
from trueup_worker.progress import Progress

SEED = 0  # every method is deterministic; every provenance names a seed


def compute(parts: Parts, job: JobRecord, progress: Progress) -> dict[str, Json]:
    """Fits, stores the arrays, and returns the manifest and the report.

    Repeating it gives the same bytes.
    """
    plant, training = read_plant(parts, job), []
    request: dict[str, Any] = job.request
    if "training" in request:
        reading_training = progress.stage("reading training episodes", 0.0, 0.3)
        training = read_episodes(
            parts, job, plant, (Role.TRAINING,), reading_training, request["training"]
        )
    episodes = read_episodes(
        parts, job, plant, (Role.ADAPTATION,), progress.stage("reading episodes", 0.3, 0.5)
    )
    data = Data(plant, episodes, training)
    predictor, report = METHODS[str(job.request["method"])](
        data, job.request, progress.stage("fitting", 0.5, 0.95)
    )
    progress.stage("packing", 0.95, 1.0)
    artifact = pack(predictor, _provenance(job, data, report))
    return {
        "manifest": artifact.manifest.decode(),
        "arrays": keep_arrays(parts, artifact),
        "report": report,
    }


@dataclass(frozen=True, slots=True)
class Data:
    """What a fit reads: the plant, its adaptation episodes, and training episodes of its family."""

    plant: Plant
    episodes: list[Episode]
    training: list[Episode]

    @property
    def fitted_on(self) -> list[Episode]:
        """The episodes of which a fit takes its transitions: of a family the training episodes."""
        return self.training or self.episodes


Fitted = tuple[Predictor, dict[str, Json]]


def _identify(data: Data, request: Mapping[str, Any], progress: Progress) -> Fitted:
    identified, report = identify(data.plant, data.episodes, progress)
    return identified, {"method": "identify", **report.document()}


def _residual(data: Data, request: Mapping[str, Any], progress: Progress) -> Fitted:
    features, penalty = tuple(request.get("features") or ()), request.get("penalty") or RIDGE
    residual, report = fit_residual(data.plant, data.episodes, features, penalty, progress)
    return residual, {"method": "residual", **report.document()}


def _blind(data: Data, request: Mapping[str, Any], progress: Progress) -> Fitted:
    family_fit = _family(data, request, Context(CONFIGURATION))
    return family_fit.blind, {"method": "blind", **family_fit.document}


def _conditioned(data: Data, request: Mapping[str, Any], progress: Progress) -> Fitted:
    family_fit = _family(data, request, context_of(request))
    return family_fit.conditioned, {"method": "conditioned", **family_fit.document}


def _family(data: Data, request: Mapping[str, Any], context: Context) -> Randomised:
    """Both predictors of a family, from its training episodes."""
    plant, declared = data.plant, request.get("randomisation")
    box = None if declared is None else Randomisation.of(plant, declared).box()
    deployment = context.parameters(plant, data.episodes)
    return fit_family(plant, pooled(plant, data.training), context, deployment, box, data.episodes)


METHODS: Mapping[str, Callable[[Data, Mapping[str, Any], Progress], Fitted]] = {
    "identify": _identify,
    "residual": _residual,
    "blind": _blind,
    "conditioned": _conditioned,
}


def _provenance(job: JobRecord, data: Data, report: dict[str, Json]) -> dict[str, Json]:
    boxes: dict[str, Json] = {
        name: report[name] for name in ("family_box", "sample_box") if name in report
    }
    return {
        "origin": "fit",
        "episodes": sources([*data.training, *data.episodes]),
        "coverage": [c.document() for c in coverage_of(data.plant, data.fitted_on)],
        **({"randomisation": boxes} if boxes else {}),
        "configuration": {"sha256": digest_of(job.request), "document": job.request},
        "code": code_identity(),
        "seed": SEED,
        "parent": job.request["parent"],
        "report": report,
    }


def effects(
    parts: Parts, tx: Transaction, job: JobRecord, outcome: dict[str, Any], context: ActorContext
) -> None:
    """Adds the candidate as the plant's next version."""
    add_artifact(tx, job.plant, Artifact(outcome["manifest"].encode(), b""), job.id, context)


def result(outcome: dict[str, Any]) -> dict[str, Json]:
    """Returns the result of the job."""
    return {"artifact": digest_of_bytes(outcome["manifest"].encode()), "fit": outcome["report"]}
