"""Designed against random: how many samples of the chapter's excitation tell the deployment plant's
numbers as well.

A pilot, the chapter's 140 random steps with noise, leaves a posterior; the excitation is designed
for it. Both are compared at the true plant, over random excitations of growing length, and the
design is run on 1,000 plants drawn from the posterior.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.report import Figure, show
from tests.support.simulated import episode_of
from trueup.chapter.data import DEPLOYMENT, DT_S, PLANT, drive, excitation
from trueup.collect.bounds import Bounds
from trueup.collect.ensemble import TWO_SIDED, Ensemble, InPlay
from trueup.collect.excitation import Setting, identification
from trueup.collect.goal import widths
from trueup.episode.role import Role
from trueup.fit.identify import identify
from trueup.model.series import DECLARED
from trueup.simulate.machine import Run

SEED, PILOT, RANDOM, DURATIONS_S = 20262, 140, 200, (10.0, 12.0, 16.0)
NOISE = np.array([0.002, 0.004])


def posterior(rng) -> Ensemble:
    issued = excitation(PILOT, rng)
    states = drive(DEPLOYMENT, np.zeros(2), issued)[: len(issued)]
    seen = states + NOISE * rng.standard_normal(states.shape)
    pilot = episode_of(
        PLANT, Run(np.arange(len(issued)) * DT_S, issued, seen), Role.ADAPTATION, "pilot"
    )
    _, found = identify(PLANT, [pilot])
    centre = PLANT.block.nulls.copy()
    centre[:3] = list(found.parameters.values())
    spread = np.array(list(found.half_widths.values())) / TWO_SIDED
    return replace(Ensemble.prior(PLANT, 0.1), centre=centre, spread=spread, scheme=DECLARED)


def main() -> None:
    rng = np.random.default_rng(SEED)
    ensemble = posterior(rng)
    truth = ensemble.centre.copy()
    truth[:3] = DEPLOYMENT
    figures = []
    for duration_s in DURATIONS_S:
        found = identification(
            Setting(
                InPlay((ensemble,)), Bounds.of(PLANT, duration_s), NOISE, np.zeros(2), np.zeros(1)
            ),
            rng,
        )
        # a random one ends without waiting for rest, too
        command = found.command[: 2 + int(np.flatnonzero(found.command[:, 0])[-1])]
        ours = _widths(ensemble, truth, command)
        needed = next(
            n
            for n in range(len(command), 40 * len(command), 10)
            if (_random(ensemble, truth, n) <= ours).all()
        )
        ratio = len(command) / needed
        what = (
            f"{len(command)} designed samples, as wide an interval of every number as random ones"
        )
        figures.append(Figure(what, f"{ratio:.2f} of {needed}", "<= 0.50", ratio <= 0.5))
        figures.append(
            Figure(
                "  breaches under 1,000 plants of the posterior",
                f"{found.breaches}",
                "0",
                found.breaches == 0,
            )
        )
    show("Excitation, designed", figures)


def _widths(ensemble: Ensemble, truth: np.ndarray, command: np.ndarray) -> np.ndarray:
    return widths(
        ensemble.fisher(truth, np.arange(len(command)) * DT_S, command, np.zeros(2), NOISE)
    )


def _random(ensemble: Ensemble, truth: np.ndarray, samples: int) -> np.ndarray:
    """Mean width over random excitations of so many samples."""
    drawn = [excitation(samples, np.random.default_rng(i))[:, None] for i in range(RANDOM // 10)]
    return np.mean([_widths(ensemble, truth, u) for u in drawn], axis=0)


if __name__ == "__main__":
    main()
