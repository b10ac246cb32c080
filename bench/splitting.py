"""Splitting: recordings too short and too noisy for one answer, then the experiment that `trueup
excite --split` designs.

Machines of the second simulator with one effect each; of those whose diagnosis left alternatives
that a command could part, each plays the designed excitation twice, and beside it random ones of
the same energy and length, and is diagnosed again with either.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.report import Figure, show
from tests.support.simulated import episode_of, episodes_of, plant_of
from trueup.collect.bounds import Bounds
from trueup.collect.ensemble import Ensemble, InPlay
from trueup.collect.excitation import Excitation, Setting, splitting
from trueup.diagnose.diagnosis import Diagnosis, diagnose
from trueup.diagnose.next_experiment import DETECTABLE
from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.errors import NotIdentifiable
from trueup.model.plant import Plant
from trueup.simulate.machine import run
from trueup.simulate.trial import CATALOGUE, JointBench, SimulatedTrial, draw, draw_bench

MACHINES, SECONDS, DRAWN = 20, 8.0, 400
SHORT = {"duration_s": 2.5, "noise": 0.05}
GAPS = (0.1, 0.3)
ROOM = 1.5  # times the travel that was recorded: the envelope
LEFT_OUT = ("dropped_frames", "sensor_quantization")  # counted in the samples, not fitted


def main() -> None:
    rng = np.random.default_rng(20265)
    tried = right = unique = ours = theirs = alike = breached = 0
    for _ in range(DRAWN):
        bench, effect, plant, trial, episodes = _undecided(rng)
        found = diagnose(plant, episodes)
        left = Ensemble.alternatives(plant, found.document)
        if not left:
            continue
        play = InPlay((Ensemble.posterior(found.predictor, found.document), *left))
        try:
            made = _designed(plant, play, trial, rng)
        except NotIdentifiable:
            alike += 1
            continue
        tried += 1
        designed = [made.command[:, 0]] * 2
        random = [_random(plant, made, rng) for _ in designed]
        answers = [
            _again(bench, plant, trial, episodes, commands, rng) for commands in (designed, random)
        ]
        unique += _is(found, effect)
        right += _is(found, effect, among=True)
        ours += _is(answers[0][0], effect)
        theirs += _is(answers[1][0], effect)
        breached += answers[0][1]
        if tried == MACHINES:
            break
    figures = [
        Figure("machines with alternatives that a command could part", str(tried)),
        Figure("  the effect among the alternatives", f"{right}"),
        Figure("  left by themselves: no command parts them", f"{alike}"),
        Figure(
            "named alone after the designed excitation",
            f"{ours} of {tried}",
            f"> {theirs}, random",
            ours > theirs,
        ),
        Figure("  after random ones of the same energy and length", f"{theirs} of {tried}"),
        Figure("  before", f"{unique} of {tried}"),
        Figure("  machines that left their envelope", f"{breached}", "0", breached == 0),
    ]
    show("Splitting alternatives", figures)


def _undecided(
    rng: np.random.Generator,
) -> tuple[JointBench, str, Plant, SimulatedTrial, list[Episode]]:
    """A machine, its effect, and short recordings."""
    bench = replace(draw_bench(str(rng.choice(["A1", "B1"])), rng), **SHORT)
    effect = str(rng.choice([name for name in CATALOGUE if name not in LEFT_OUT]))
    trial = draw(bench, [effect], True, rng, gaps=GAPS)
    plant = plant_of(bench)
    episodes = episodes_of(plant, trial)
    far = ROOM * max(float(np.nanmax(np.abs(e.observations[:, 0]))) for e in episodes)
    plant = Plant.from_document({**plant.document, "envelope": {"q": [-far, far]}})
    return bench, effect, plant, trial, episodes_of(plant, trial)


def _designed(
    plant: Plant, play: InPlay, trial: SimulatedTrial, rng: np.random.Generator
) -> Excitation:
    setting = Setting(play, Bounds.of(plant, SECONDS), trial.sigma, np.zeros(2), np.zeros(1))
    made = splitting(setting, rng, effort=0.25)
    if made.information.least < DETECTABLE:  # type: ignore[attr-defined]
        raise NotIdentifiable("no command parts them")
    return made


def _random(plant: Plant, made: Excitation, rng: np.random.Generator) -> np.ndarray:
    return made.bounds.random(np.zeros(1), made.command, rng)[:, 0]


def _again(
    bench: JointBench,
    plant: Plant,
    trial: SimulatedTrial,
    episodes: list[Episode],
    commands: list[np.ndarray],
    rng: np.random.Generator,
) -> tuple[Diagnosis, bool]:
    """The diagnosis with two more recordings, and whether the machine left its envelope in one of
    them."""
    low, high = plant.envelope["q"]
    more, outside = [], False
    for role, command in zip((Role.ADAPTATION, Role.VALIDATION), commands, strict=True):
        played = run(trial.machine, command, bench.timestep_s, bench.parts, tuple(trial.sigma), rng)
        outside |= bool(((played.observed[:, 0] < low) | (played.observed[:, 0] > high)).any())
        more.append(episode_of(plant, played, role, f"more-{role}"))
    return diagnose(plant, [*episodes, *more]), outside


def _is(found: Diagnosis, effect: str, *, among: bool = False) -> bool:
    """Whether a diagnosis names the effect, alone or among its alternatives; twins by law are
    one."""
    twin = {"sensor_delay": "actuator_delay"}
    named = {e["effect"] for e in found.document["effects"]}
    others = [set(o) for o in found.document["indistinguishable"]]
    wanted = {effect, twin.get(effect, effect)}
    if among:
        return bool(named & wanted) or any(o & wanted for o in others)
    left = [o for o in others if not o <= {"sensor_delay"} | wanted]
    return len(named) == 1 and bool(named & wanted) and not left


if __name__ == "__main__":
    main()
