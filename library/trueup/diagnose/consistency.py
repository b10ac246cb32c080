"""Consistency: whether other recordings of the same machine give the same numbers.

The composition of a model is fitted to all recordings together, then to each recording, each day
and each value of a collection condition alone. Numbers whose estimates differ by more than their
own intervals allow are not one number of one machine: something acts that the model does not have,
or the machine changed. Diagnoses of subsets from the start say whether they even name the same
effects.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from trueup.canonical import Json
from trueup.diagnose.between_recordings import Agreement, Alone, Difference, alone, named
from trueup.diagnose.data_quality import assess
from trueup.diagnose.diagnosis import diagnose
from trueup.diagnose.intervals import half_widths
from trueup.diagnose.problem_setup import Recordings, Setup, in_pieces
from trueup.diagnose.report import named_term
from trueup.diagnose.summary_text import sentence
from trueup.diagnose.tasks import Solve, in_threads
from trueup.diagnose.windowed_fits import WindowedFits
from trueup.doctor.examine import usable
from trueup.episode.episode import NAME, Episode
from trueup.episode.role import Role
from trueup.errors import NotIdentifiable
from trueup.fit.rollout_fit import RolloutFit
from trueup.model.corrected import Corrected
from trueup.model.plant import Plant
from trueup.model.predictor import Predictor
from trueup.model.series import Series

SCHEMA = "trueup.consistency/1"
RECORDING, DAY, HALF = NAME, "day", "half"
FEWEST = 2  # recordings
COMPARED = Role.ADAPTATION, Role.VALIDATION
# conditions that are no grouping of their own: whose log it is, what the recording is called, and
# what is a grouping already
NOT_A_GROUP = ("stage", RECORDING, DAY, HALF)
NO_NAMES: Mapping[str, str] = MappingProxyType({})
Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True)
class Grouping:
    """A way to part the recordings: its name, and the digests of each subset's recordings by the
    subset's name."""

    name: str
    subsets: Mapping[str, Sequence[str]]


def consistency(
    model: Predictor,
    episodes: Sequence[Episode],
    progress: Progress = lambda _stage, _part: None,
    *,
    diagnoses: bool = False,
    names: Mapping[str, str] = NO_NAMES,
    solve: Solve = in_threads,
) -> dict[str, Json]:
    """Whether subsets of some recordings agree on a model's numbers, as the document
    `trueup.consistency/1`. `names` are what recordings are called, by digest.

    With `diagnoses` subsets are diagnosed from the start, too: days and conditions where there are
    such, else the earlier and the later half. Episodes of other roles are kept apart. Raises
    NotIdentifiable of a model without parameters, and of fewer than two usable recordings.
    """
    form = Corrected.form_of(model)
    if form is None:
        raise NotIdentifiable(
            f"a model of the kind {model.kind} has no parameters that recordings could agree on",
            hint="Name the declared model, an identified one, or one of a diagnosis.",
        )
    progress("reading the recordings", 0.0)
    compared = [e for e in episodes if e.role in COMPARED]
    ordered = sorted(compared, key=lambda e: (e.start_ns, e.digest))
    kept = usable(form.plant, ordered).episodes
    recorded = [e for e in ordered if any(k.recording == e.digest for k in kept)]
    if len(recorded) < FEWEST:
        raise NotIdentifiable(
            "there are not two recordings that could agree",
            hint="Give two recordings of the same machine at least.",
        )
    fits, together = _together(form, kept, progress)
    series: dict[str, list[Series]] = {}
    origin = {e.digest: e.recording for e in kept}
    for s in fits.adaptation:
        series.setdefault(origin[s.digest], []).append(s)
    parted = groupings(recorded)
    agreements = {}
    for done, grouping in enumerate(parted):
        progress(f"each {grouping.name} alone", done / len(parted))
        subsets = {
            name: [s for digest in digests for s in series[digest]]
            for name, digests in grouping.subsets.items()
        }
        agreements[grouping.name] = Agreement.of(together, alone(fits, together, subsets))
    document: dict[str, Json] = {
        "schema": SCHEMA,
        "plant": form.plant.name,
        "effects": [named_term(form.plant, t) for t in form.hypothesis.effects],
        "recordings": [_recording(e, names.get(e.digest)) for e in recorded],
        "groupings": [
            {"grouping": g.name, "subsets": {n: list(d) for n, d in g.subsets.items()}}
            for g in parted
        ],
        "numbers": _numbers(form.plant, together, agreements),
        "diagnoses": [],
    }
    if diagnoses:
        document["diagnoses"] = _diagnoses(form.plant, recorded, parted, progress, solve)
    progress("done", 1.0)
    return document


def groupings(recorded: Sequence[Episode]) -> list[Grouping]:
    """The ways to part some recordings into two subsets at least: by recording; by day (UTC) and by
    each collection condition, where those part them less finely; else the earlier and the later
    half of them."""
    parted = [Grouping(RECORDING, {e.digest: [e.digest] for e in recorded})]
    by_day: dict[str, list[str]] = {}
    for e in recorded:
        by_day.setdefault(_day(e), []).append(e.digest)
    ways: dict[str, dict[str, list[str]]] = {DAY: by_day}
    for e in recorded:
        for condition, value in e.conditions.items():
            if condition not in NOT_A_GROUP:
                ways.setdefault(condition, {}).setdefault(value, []).append(e.digest)
    coarse = [
        Grouping(name, subsets)
        for name, subsets in ways.items()
        if FEWEST <= len(subsets) < len(recorded)
    ]
    if not coarse and len(recorded) >= 2 * FEWEST:
        coarse = [_halves([e.digest for e in recorded])]
    return parted + coarse


def _halves(digests: Sequence[str]) -> Grouping:
    """The earlier and the later half of some recordings."""
    middle = (len(digests) + 1) // 2
    return Grouping(HALF, {"earlier": digests[:middle], "later": digests[middle:]})


def _day(episode: Episode) -> str:
    """The day (UTC) on which a recording began."""
    return str(np.datetime64(episode.start_ns, "ns").astype("datetime64[D]"))


def _recording(episode: Episode, name: str | None) -> dict[str, Json]:
    return {
        "sha256": episode.digest,
        "name": name or episode.name,
        "role": str(episode.role),
        "day": _day(episode),
        "conditions": dict(episode.conditions),
        "duration_s": float(episode.t_s[-1]),
    }


def _together(
    form: Corrected, kept: Sequence[Episode], progress: Progress
) -> tuple[WindowedFits, RolloutFit]:
    """The windows of all recordings, and the composition fitted to them from the model's numbers.

    Raises NotIdentifiable where the model runs away.
    """
    plant = form.plant
    recordings = Recordings(plant, kept, kept)
    setup = Setup(recordings, assess(plant, kept), form.scheme)
    fits = setup.windowed_fits(recordings.window_s)
    if recordings.strategy.robot:
        pieces = in_pieces(plant, setup.episodes[0], fits.scheme, fits.length_s, setup.merged)
        fits = replace(fits, pieces=pieces)
    if recordings.strategy.physical:
        fits = replace(fits, fitter=fits.fitter.holding())
    progress("all recordings together", 0.0)
    values, data = np.array(form.values), fits.adaptation
    as_it_is = fits.fitter.fit(data, form.hypothesis, values, iterations=0)
    fit = fits.alone(data, as_it_is)
    if not np.isfinite(fit.cost):
        raise NotIdentifiable(
            "the model runs away on these recordings, so none of its numbers can be estimated",
            hint="Diagnose the plant first, and name the version of the diagnosis.",
        )
    return fits, fit


def _numbers(plant: Plant, together: RolloutFit, agreements: Mapping[str, Agreement]) -> list[Json]:
    """Each number: what all recordings say together, and what the subsets of each grouping say."""
    halves = half_widths(together, together)
    entries: list[Json] = []
    for name, value in zip(together.free.names, together.free.at(together.values), strict=True):
        called, factor = named(plant, *name)
        estimate = Alone(float(value), halves[name])
        by: list[Json] = [
            _by(grouping, agreement.by_number[name], factor)
            for grouping, agreement in agreements.items()
            if name in agreement.by_number
        ]
        entries.append({**called, **estimate.document(factor), "by": by})
    return entries


def _by(grouping: str, difference: Difference, factor: float) -> dict[str, Json]:
    """What the subsets of one grouping say of a number."""
    return {
        "grouping": grouping,
        **difference.document(factor),
        "subsets": [
            {"subset": name, **e.document(factor)} for name, e in difference.estimates.items()
        ],
    }


def _diagnoses(
    plant: Plant,
    recorded: Sequence[Episode],
    parted: Sequence[Grouping],
    progress: Progress,
    solve: Solve,
) -> list[Json]:
    """A diagnosis of the adaptation episodes of each subset, all compared on the same validation
    episodes."""
    validation = [e for e in recorded if e.role is Role.VALIDATION]
    adaptation = {e.digest: e for e in recorded if e.role is Role.ADAPTATION}
    by_days_and_conditions = [g for g in parted if g.name not in (RECORDING, HALF)]
    asked = [
        (grouping.name, name, [adaptation[d] for d in subset if d in adaptation])
        for grouping in (by_days_and_conditions or [_halves(list(adaptation))])
        for name, subset in grouping.subsets.items()
    ]
    some = [(grouping, name, episodes) for grouping, name, episodes in asked if episodes]
    rows: list[Json] = []
    for done, (grouping, name, episodes) in enumerate(some):
        stage = f"a diagnosis of the {grouping} {name}"
        progress(stage, done / len(some))
        try:
            document = diagnose(plant, [*episodes, *validation], solve=solve).document
        except NotIdentifiable as error:
            rows.append({"grouping": grouping, "subset": name, "problem": str(error)})
            continue
        rows.append({"grouping": grouping, "subset": name, **diagnosed(document)})
    return rows


def diagnosed(report: Mapping[str, Any]) -> dict[str, Json]:
    """What a report says, for a table of diagnoses: verdict, sentence, effects with estimates, and
    how far the gap closes."""
    return {
        "verdict": report["verdict"],
        "sentence": sentence(report),
        "effects": [
            {k: e[k] for k in ("effect", "joint", "parameters", "estimate") if k in e}
            for e in report["effects"]
        ],
        "closed": report["gap"]["closed"],
    }
