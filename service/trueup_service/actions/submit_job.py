"""Submit a job: freeze everything that it will read, and hand it to the engine in the same
transaction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from trueup.canonical import Json
from trueup.episode.role import HEALTHY, HELD_OUT, WATCHED, Role
from trueup.errors import NotIdentifiable
from trueup_service.actions import find
from trueup_service.actions.submission import Submission, digests_of, require_some
from trueup_service.actions.submit_study import (
    submit_closedloop,
    submit_comparison,
    submit_consistency,
    submit_excitation,
    submit_openloop,
)
from trueup_service.actions.submit_trial import submit_gate
from trueup_service.registry.records import EpisodeRecord, JobRecord

# One episode differs by luck alone by as much as an alarm takes.
LEAST_VALIDATED = 5  # episodes
RANGES = "randomisation.json"  # the file of a diagnosis with the ranges that it supports
OF_FAMILIES = ("blind", "conditioned")  # methods that fit one map for a family of plants


def submit_fit(s: Submission) -> JobRecord:
    """Submit a fit of `method` from the named adaptation episodes, or from all of them; of a whole
    family from training episodes. Raises NotFound, RoleRefused, NotIdentifiable, BadArtifact."""
    find.plant_digest(s.tx, s.plant)
    _require_known_features(s)
    if s.request["method"] not in OF_FAMILIES:
        episodes = s.safeguarded(Role.ADAPTATION)
        require_some(episodes, Role.ADAPTATION, "adaptation episode to fit")
        return s.enqueue("fit", _from_parent(s, digests_of(episodes)))
    episodes = s.safeguarded(Role.ADAPTATION, optional=True)
    training = s.safeguarded(Role.TRAINING, field="training")
    require_some(training, Role.TRAINING, "training episode of a plant of the family")
    if s.request["method"] == "conditioned":
        require_context(s, episodes)
    frozen = _from_parent(s, digests_of(episodes))
    return s.enqueue("fit", {**frozen, "training": list(digests_of(training))})


def _require_known_features(s: Submission) -> None:
    """Raises BadArtifact for a feature of a residual that the plant does not have."""
    features: Any = s.request.get("features")
    if not features:
        return
    import numpy as np  # noqa: PLC0415  (a server that only serves needs none)

    from trueup.model.features import design, known_features  # noqa: PLC0415  (numpy)
    from trueup.model.plant import Plant  # noqa: PLC0415  (numpy)

    plant = Plant.from_document(find.plant(s.tx, s.plant).document)
    known_features(features, parameters=())
    states, commands = np.zeros((1, 2 * len(plant.joints))), len(plant.layout.commands)
    design(features, states, np.zeros((1, commands)), {})


def submit_diagnosis(s: Submission) -> JobRecord:
    """Submit a diagnosis of the nominal model from adaptation and validation episodes. Raises
    NotFound, RoleRefused, NotIdentifiable."""
    return _submit_on_both(s, "diagnose")


def submit_blindtrial(s: Submission) -> JobRecord:
    """Submit a blind trial that imitates adaptation and validation episodes. Raises NotFound,
    RoleRefused, NotIdentifiable."""
    return _submit_on_both(s, "blindtrial")


def _submit_on_both(s: Submission, kind: str) -> JobRecord:
    find.plant_digest(s.tx, s.plant)
    episodes = s.safeguarded(Role.ADAPTATION, Role.VALIDATION)
    for role in (Role.ADAPTATION, Role.VALIDATION):
        of_role = [e for e in episodes if e.role == role]
        require_some(of_role, role, f"{role} episode to start from")
    return s.enqueue(kind, _from_parent(s, digests_of(episodes)))


def _from_parent(s: Submission, episodes: list[str]) -> dict[str, Json]:
    """The request on these episodes, with the artifact that serves now."""
    parent = find.serving(s.tx, s.plant).artifact
    return {**s.request, "episodes": list(episodes), "parent": parent}


def submit_calibration(s: Submission) -> JobRecord:
    """Submit the calibration of a monitor of what serves now, on the named healthy episodes, or on
    all of the role reference. Raises NotFound, RoleRefused, NotIdentifiable."""
    find.plant_digest(s.tx, s.plant)
    episodes = s.episodes(*HEALTHY, otherwise=(Role.REFERENCE,))
    if not episodes:
        raise NotIdentifiable(
            "there is no reference episode",
            hint="Upload healthy operation whose metadata says role = reference.",
        )
    frozen: dict[str, Json] = {
        **s.request,
        "episodes": list(digests_of(episodes)),
        "artifact": find.serving(s.tx, s.plant).artifact,
    }
    return s.enqueue("calibrate", frozen)


def submit_watch(s: Submission) -> JobRecord | None:
    """Submit a look at the episodes that the plant's monitor has not seen. Returns None where there
    are none, a look waits already, or no monitor watches what serves."""
    tx, plant = s.tx, s.plant
    watching = tx.watches.current(plant)
    if watching is None or tx.jobs.is_queued(plant, "watch"):
        return None
    if find.monitor(tx, plant, watching.monitor).artifact != find.serving(tx, plant).artifact:
        return None
    if not tx.episodes.unwatched(watching, WATCHED, 1):
        return None
    return s.enqueue("watch", {"monitor": watching.monitor})


def submit_validation(s: Submission) -> JobRecord:
    """Submit a validation of what serves on the episodes held out since its promotion, beside those
    on which the promotion was judged.

    Raises NotIdentifiable where fewer than LEAST_VALIDATED were held out.
    """
    tx, plant = s.tx, s.plant
    now = find.serving(tx, plant)
    judged: Any = (
        [] if now.decision is None else find.decision(tx, plant, now.decision).document["episodes"]
    )
    gate: Any = (
        {}
        if now.decision is None
        else find.gate(tx, plant, find.decision(tx, plant, now.decision).gate).document
    )
    new = [
        e
        for e in tx.episodes.of_roles(plant, HELD_OUT, ingested_after=now.at)
        if e.digest not in judged
    ]
    if len(new) < LEAST_VALIDATED:
        hint = f"Upload {LEAST_VALIDATED} episodes with the role validation at least."
        raise NotIdentifiable(
            f"only {len(new)} episodes were held out since this model serves", hint=hint
        )
    frozen: dict[str, Json] = {
        "artifact": now.artifact,
        "episodes": [*judged, *digests_of(new)],
        "new": list(digests_of(new)),
        "conditions": gate.get("conditions", []),
    }
    return s.enqueue("validate", frozen)


def submit_recomputation(s: Submission) -> JobRecord:
    """Submit the recomputation of a decision from its bytes. Raises NotFound."""
    made = find.decision(s.tx, s.plant, str(s.request["decision"]))
    frozen: dict[str, Json] = {"decision": made.digest, "episodes": made.document["episodes"]}
    return s.enqueue("recompute", frozen)


def submit_randomisation(s: Submission) -> JobRecord:
    """Submit draws from a family of plants, and fits of its predictors. Raises NotFound,
    RoleRefused, NotIdentifiable."""
    find.plant_digest(s.tx, s.plant)
    episodes = s.safeguarded(Role.ADAPTATION, optional=True)
    require_context(s, episodes)
    frozen = _from_parent(s, digests_of(episodes))
    if "randomisation" not in s.request:
        frozen["diagnosis"] = _ranges(s).id
    return s.enqueue("randomise", frozen)


def require_context(s: Submission, episodes: Sequence[EpisodeRecord]) -> None:
    """Raises NotIdentifiable where a context is to be identified, and there is no episode to."""
    context: Any = s.request.get("context") or {}
    if context.get("by", "identification") == "identification" and not episodes:
        raise NotIdentifiable(
            "there is no adaptation episode to identify the context from",
            hint="Upload one, or give the context by configuration or by measurement.",
        )


def _ranges(s: Submission) -> JobRecord:
    """The diagnosis whose ranges are drawn from: the named one, else the newest that left any.
    Raises NotFound, NotIdentifiable."""
    named = s.request.get("diagnosis")
    if named is not None:
        job = find.job(s.tx, str(named))
        if job.plant != s.plant or job.kind != "diagnose":
            raise find.not_found("diagnosis", str(named))
        find.output(s.tx, job.id, RANGES)
        return job
    newest = s.tx.jobs.last_with_output(s.plant, "diagnose", RANGES)
    if newest is None:
        raise NotIdentifiable(
            "no family is declared, and no diagnosis of this plant has left ranges",
            hint="Declare `randomisation`, or diagnose the plant.",
        )
    return newest


SUBMIT = {
    "randomise": submit_randomisation,
    "validate": submit_validation,
    "calibrate": submit_calibration,
    "fit": submit_fit,
    "gate": submit_gate,
    "diagnose": submit_diagnosis,
    "blindtrial": submit_blindtrial,
    "recompute": submit_recomputation,
    "compare": submit_comparison,
    "openloop": submit_openloop,
    "closedloop": submit_closedloop,
    "consistency": submit_consistency,
    "excite": submit_excitation,
}
