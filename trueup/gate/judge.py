"""Judge: a trial under a frozen gate becomes a decision."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from trueup.canonical import Json
from trueup.control.closed_loop import Tracking, Travelled, compare
from trueup.episode.episode import Episode
from trueup.episode.role import HELD_OUT
from trueup.errors import BadGate
from trueup.fit.score import score
from trueup.gate.cells import cells_of, matrix
from trueup.gate.decision import Decision, Gate, figures
from trueup.gate.rule import Trial
from trueup.model.corrected import Corrected
from trueup.model.predictor import Predictor


def run_trial(
    gate: Gate, candidate: Predictor, incumbent: Predictor, episodes: Sequence[Episode], progress: Callable[[float], None] = lambda _: None
) -> Trial:
    """Score both predictors on held-out episodes. Raises RoleRefused for any other role, BadGate without episodes."""
    if not episodes:
        raise BadGate("there is no held-out episode to judge on")
    for episode in episodes:
        episode.require(*HELD_OUT)
    scores = []
    driven = any(rule.closed_loop for rule in gate.rules)
    for done, predictor in enumerate((candidate, incumbent), 1):
        scores.append(score(predictor, episodes, gate.scoring))
        progress(done / (4.0 if driven else 2.0))
    tracking = _driven(candidate, incumbent, episodes, lambda share: progress(0.5 + 0.5 * share)) if driven else None
    named = tuple(e.digest for e in episodes)
    return Trial(scores[0], scores[1], named, cells_of(episodes, gate.conditions), gate.conditions, tracking)


def _driven(candidate: Predictor, incumbent: Predictor, episodes: Sequence[Episode], progress: Callable[[float], None]) -> Tracking:
    """Both in closed loop on the machine as it was diagnosed: as the candidate says, or if it is no diagnosis the incumbent.

    Raises BadGate where neither is.
    """
    machine = next((p for p in (candidate, incumbent) if isinstance(p, Corrected)), None)
    if machine is None:
        hint = "Judge what a diagnosis made, or leave the rule out."
        raise BadGate("nobody has diagnosed the machine on which to run in closed loop", hint=hint)
    return compare(machine, candidate, incumbent, Travelled.of(machine.plant, episodes), progress)


def judge(gate: Gate, trial: Trial, *, plant: str, candidate: str, incumbent: str, generation: int) -> Decision:
    """Every rule's verdict on the trial; `candidate` and `incumbent` are artifact digests, `plant` the plant's."""
    verdicts = tuple(rule(trial) for rule in gate.rules)
    found: dict[str, Json] = {"candidate": figures(trial.candidate), "incumbent": figures(trial.incumbent)}
    if trial.tracking is not None:
        found["closed_loop"] = trial.tracking.document()
    if gate.conditions:
        found["cells"] = matrix(trial.cells, gate.conditions, trial.candidate.rollout, trial.incumbent.rollout)
    return Decision(plant, gate.digest, candidate, incumbent, generation, trial.episodes, verdicts, found)
