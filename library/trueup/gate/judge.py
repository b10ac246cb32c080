"""Judge: a trial under a frozen gate becomes a decision."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.control.closed_loop import Driven, Tracking, compare, tracking_of
from trueup.control.courses import Courses, Travelled
from trueup.control.machine import Machine, stand_in
from trueup.episode.episode import Episode
from trueup.episode.role import HELD_OUT
from trueup.errors import BadGate
from trueup.fit.score import Missed, Score, missed, score, score_of
from trueup.gate.cells import cells_of, matrix
from trueup.gate.controls import controls, judged
from trueup.gate.decision import Decision, Gate, figures
from trueup.gate.rule import Trial, Verdict
from trueup.model.predictor import Predictor

Array = NDArray[np.float64]
# The closed-loop runs of the candidate and of the incumbent; the share that is done is reported.
DriveBoth = Callable[[Callable[[float], None]], tuple[Driven, Driven]]
SCALED = (0.5, 2.0)  # times a channel's declared reporting scale
NOTHING_KNOWN: Mapping[str, Json] = MappingProxyType(
    {"candidate": [], "episodes": [], "compared": []}
)


@dataclass(frozen=True)
class TrialRun:
    """A trial that was run: its scores, each model's residuals in each episode, the verdicts on the
    negative controls, and the scores of the models beside the candidate, by digest."""

    trial: Trial
    candidate: tuple[Missed, ...]
    incumbent: tuple[Missed, ...]
    controls: Mapping[str, Json]
    beside: Mapping[str, Score] | None


def run_trial(
    gate: Gate,
    candidate: Predictor,
    incumbent: Predictor,
    episodes: Sequence[Episode],
    progress: Callable[[float], None] = lambda _: None,
    copy: Predictor | None = None,
    beside: Mapping[str, Predictor] | None = None,
    drive_both: DriveBoth | None = None,
) -> TrialRun:
    """Score both predictors on held-out episodes; `copy` is the incumbent, loaded once more. The
    controls are judged before the candidate.

    Models `beside` the candidate, by digest, are scored too, so that the decision shows which of
    them errs as the candidate does. Closed-loop runs are made here, or by `drive_both`. Raises
    RoleRefused for an episode of another role, BadGate without episodes, VacuousGate where the gate
    accepts a control.
    """
    if not episodes:
        raise BadGate("there is no held-out episode to judge on")
    for episode in episodes:
        episode.require(*HELD_OUT)
    driven = any(rule.closed_loop for rule in gate.rules)
    share = 0.5 if driven else 1.0
    named, cells = tuple(e.digest for e in episodes), cells_of(episodes, gate.conditions)
    scales = candidate.plant.scales
    against = tuple(missed(incumbent, e, gate.scoring) for e in episodes)
    stages = 3 + len(beside or {})
    progress(share / stages)
    serving = score_of(against, scales)
    copied = serving if copy is None else score(copy, episodes, gate.scoring)
    progress(share * 2.0 / stages)
    alone = Trial(serving, serving, named, cells, gate.conditions, _still(driven))
    shown = controls(gate, alone, against, copied, scales, _spreads(episodes))
    by = tuple(missed(candidate, e, gate.scoring) for e in episodes)
    others = {}
    for count, (name, model) in enumerate((beside or {}).items(), 3):
        progress(share * count / stages)
        others[name] = score(model, episodes, gate.scoring)
    progress(share)
    tracking = (
        _driven(
            candidate,
            incumbent,
            episodes,
            lambda done: progress(share + share * done),
            drive_both,
        )
        if driven
        else None
    )
    trial = Trial(score_of(by, scales), serving, named, cells, gate.conditions, tracking)
    return TrialRun(trial, by, against, shown, None if beside is None else others)


def _spreads(episodes: Sequence[Episode]) -> Array:
    """The standard deviation of each channel over all episodes in its own unit, `(channels,)`; 0
    where it is not observed in any."""
    observed = np.ma.masked_invalid(np.concatenate([e.observations for e in episodes]))
    return np.asarray(observed.std(axis=0).filled(0.0), np.float64)


def _still(driven: bool) -> Tracking | None:
    """The closed-loop figures of a control: equal to the incumbent's."""
    return Tracking(np.ones(1), np.ones(1), (0.0, 0.0), (1.0,)) if driven else None


def closed_loop(
    candidate: Predictor, incumbent: Predictor, episodes: Sequence[Episode]
) -> tuple[Machine, Courses]:
    """The simulated machine and the courses of a trial's closed-loop runs: the candidate's
    diagnosis of the machine, or the incumbent's; where nobody has diagnosed it, what else describes
    it best.

    Raises NotIdentifiable where no joint moved, or one takes no command.
    """
    _, machine = stand_in({"candidate": candidate, "incumbent": incumbent})
    return machine, Courses.within(machine.plant, Travelled.of(machine.plant, episodes))


def _driven(
    candidate: Predictor,
    incumbent: Predictor,
    episodes: Sequence[Episode],
    progress: Callable[[float], None],
    drive_both: DriveBoth | None,
) -> Tracking:
    """Both models in closed loop. Raises NotIdentifiable."""
    machine, courses = closed_loop(candidate, incumbent, episodes)
    if drive_both is None:
        return compare(machine, candidate, incumbent, courses, progress)
    return tracking_of(machine, courses, *drive_both(progress))


def judge(
    gate: Gate,
    trial: Trial,
    *,
    plant: str,
    candidate: str,
    incumbent: str,
    generation: int,
    controls: Mapping[str, Json] = MappingProxyType({}),
    known: Mapping[str, Json] = NOTHING_KNOWN,
    uses: Sequence[int] = (),
    selection: Mapping[str, Json] | None = None,
    beside: Mapping[str, Score] | None = None,
) -> Decision:
    """The decision: every rule's verdict on the trial. `candidate`, `incumbent` and `plant` are
    digests.

    `controls` are the verdicts on the negative controls, `known` is what was known when the gate
    was declared, `uses` how often each episode has been judged on, this time included, `selection`
    from how many the candidate and episodes were selected, `beside` the scores of other candidates
    on the episodes.
    """
    verdicts: tuple[Verdict, ...] = judged(gate, trial)
    trial_figures: dict[str, Json] = {
        "candidate": figures(trial.candidate),
        "incumbent": figures(trial.incumbent),
        "controls": dict(controls),
    }
    if beside is not None:
        trial_figures["beside"] = {name: figures(score) for name, score in beside.items()}
    if trial.tracking is not None:
        trial_figures["closed_loop"] = trial.tracking.document()
    if gate.conditions:
        trial_figures["cells"] = matrix(
            trial.cells, gate.conditions, trial.candidate.rollout, trial.incumbent.rollout
        )
    return Decision(
        plant,
        gate.digest,
        candidate,
        incumbent,
        generation,
        trial.episodes,
        verdicts,
        trial_figures,
        dict(known),
        tuple(uses),
        selection,
    )


def sensitivity(gate: Gate, run: TrialRun, scales: Array, channels: Sequence[str]) -> list[Json]:
    """How the verdict changes when each channel's reporting scale is halved and doubled: it should
    not depend on a unit of reporting.

    `scales` `(channels,)` are the declared ones. Closed-loop figures do not change, because
    tracking has scales of its own.
    """
    rows: list[Json] = []
    for column, channel in enumerate(channels):
        for factor in SCALED:
            other = scales.copy()
            other[column] *= factor
            trial = replace(
                run.trial,
                candidate=score_of(run.candidate, other),
                incumbent=score_of(run.incumbent, other),
            )
            verdicts = judged(gate, trial)
            accepted, documents = all(v.passed for v in verdicts), [v.document() for v in verdicts]
            rows.append(
                {"channel": channel, "factor": factor, "accepted": accepted, "verdicts": documents}
            )
    return rows
