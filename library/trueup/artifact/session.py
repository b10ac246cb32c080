"""Session state: what a controller holds of a model while it runs, and what it has to do when
another model takes its place."""

from __future__ import annotations

from trueup.canonical import Json
from trueup.model.block import joint, kind
from trueup.model.corrected import Corrected
from trueup.model.plant import Plant
from trueup.model.predictor import Predictor

NOTHING = "nothing to carry over: the next state follows from the last observed one alone"
FILTER = "begin the filter anew at the last observed state; its covariance settles within a window"
REMEMBERS = "begin the hidden states of its effects as the artifact says, not from the old model's"


def session_state(predictor: Predictor) -> dict[str, Json]:
    """What a running controller holds of a model: its `form`, the names of what it `remembers`
    between steps, whether a `filter` precedes a rollout, its `step_s` [s], and what to do
    `on_switch` to it, in words."""
    plant = predictor.plant
    remembers = _remembers(predictor)
    filtered = isinstance(predictor, Corrected) and bool(predictor.gain)
    actions = [*([FILTER] if filtered else []), *([REMEMBERS] if remembers else [])]
    return {
        "form": predictor.kind,
        "remembers": list(remembers),
        "filter": filtered,
        "step_s": plant.timestep_s,
        "states": _states(plant),
        "on_switch": "; ".join(actions) or NOTHING,
    }


def _states(plant: Plant) -> list[Json]:
    """The states in their order: positions, then velocities."""
    names = [plant.joint_name(j) for j in range(len(plant.joints))]
    return [f"{what} of {name}" for what in ("position", "velocity") for name in names]


def _remembers(predictor: Predictor) -> list[str]:
    """What a model's effects hold from step to step: hidden states, and delayed signals."""
    if not isinstance(predictor, Corrected):
        return []
    plant, held = predictor.plant, []
    for term in predictor.hypothesis.effects:
        effect = kind(term)
        names = [*effect.states, *(["delayed signal"] if effect.delays() else [])]
        at = f" at {plant.joint_name(joint(term))}" if plant.names_joints else ""
        held += [f"{effect.name}{at}: {name}" for name in names]
    return held
