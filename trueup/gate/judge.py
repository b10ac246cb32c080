"""Judge: a trial under a frozen gate becomes a decision."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from trueup.canonical import Json
from trueup.episode.episode import Episode
from trueup.episode.role import HELD_OUT
from trueup.errors import BadGate
from trueup.fit.score import score
from trueup.gate.cells import cells_of, matrix
from trueup.gate.decision import Decision, Gate, figures
from trueup.gate.rule import Trial
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
    for share, predictor in ((0.5, candidate), (1.0, incumbent)):
        scores.append(score(predictor, episodes, gate.scoring))
        progress(share)
    return Trial(scores[0], scores[1], tuple(e.digest for e in episodes), cells_of(episodes, gate.conditions), gate.conditions)


def judge(gate: Gate, trial: Trial, *, plant: str, candidate: str, incumbent: str, generation: int) -> Decision:
    """Every rule's verdict on the trial; `candidate` and `incumbent` are artifact digests, `plant` the plant's."""
    verdicts = tuple(rule(trial) for rule in gate.rules)
    found: dict[str, Json] = {"candidate": figures(trial.candidate), "incumbent": figures(trial.incumbent)}
    if gate.conditions:
        found["cells"] = matrix(trial.cells, gate.conditions, trial.candidate.rollout, trial.incumbent.rollout)
    return Decision(plant, gate.digest, candidate, incumbent, generation, trial.episodes, verdicts, found)
