"""Laws of a detector: it is deterministic, it looks only back, and it alarms rarely on healthy
residuals and reliably on broken ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trueup.checks.law import require
from trueup.monitor.detector import Detector, Reference
from trueup.monitor.residuals import Residuals, blocks

WINDOWS, SAMPLES, CHANNELS, SIGNATURES = 4, 25, 3, 6  # of an episode, of a window
HORIZON_S = 2.0
CORRELATED = 0.8  # from sample to sample
REFERENCE, FRESH = 120, 1500
PROMISE_H = 0.5
SLACK = 3.0  # times the promised rate: a reference of a hundred blocks says no more
BROKEN = 4.0  # times the healthy spread
PATIENCE = 30  # episodes


def healthy(rng: np.random.Generator, size: float = 1.0) -> Residuals:
    """An episode of residuals that are correlated in time and between channels, `size` times the
    healthy spread."""
    n = WINDOWS * SAMPLES
    shocks, x = rng.standard_t(8, (n, CHANNELS)) * np.sqrt(0.75), np.zeros((n, CHANNELS))
    x[0] = shocks[0]
    for i in range(1, n):
        x[i] = CORRELATED * x[i - 1] + np.sqrt(1.0 - CORRELATED**2) * shocks[i]
    values = size * (x + 0.5 * x[:, :1]) / np.sqrt([2.25, 1.25, 1.25])
    window = np.repeat(np.arange(WINDOWS), SAMPLES)
    weight = np.full(n, 1.0 / SAMPLES)
    shape = np.random.default_rng(1).normal(size=(SAMPLES, CHANNELS, SIGNATURES))
    by_window = values.reshape(WINDOWS, SAMPLES, CHANNELS)
    common = np.einsum("wsc,scl->wl", by_window, shape) / SAMPLES
    power = np.broadcast_to((shape**2).sum(axis=(0, 1)) / SAMPLES, common.shape)
    t_s = np.asarray(np.arange(1, n + 1) * HORIZON_S / SAMPLES, np.float64)
    return Residuals(
        values, t_s, weight, window, WINDOWS * HORIZON_S, np.stack([common, power], axis=2)
    )


def calibrated(kind: type[Detector]) -> Detector:
    """A detector on a healthy reference."""
    rng = np.random.default_rng(2)
    fitted, fresh = (
        [b for _ in range(REFERENCE) for b in blocks(healthy(rng), WINDOWS)] for _ in range(2)
    )
    return kind.calibrate(Reference(fitted, fresh, WINDOWS, WINDOWS * HORIZON_S, PROMISE_H), rng)


def the_same_residuals_give_the_same_answer(detector: Detector) -> None:
    """Following depends on its arguments alone, and a detector that is restored from its document
    follows like the original."""
    rng, state = np.random.default_rng(3), detector.begin()
    again = type(detector).restore(detector.document())
    for _ in range(PATIENCE):
        episode = healthy(rng, rng.uniform(0.5, 2.0))
        once, twice = (d.follow(state, episode) for d in (detector, again))
        same = np.array_equal(once.statistic, twice.statistic) and (once.alarm, once.state) == (
            twice.alarm,
            twice.state,
        )
        require(same, "the same residuals give the same answer", detector.name)
        state = once.state


def an_alarm_is_where_the_statistic_first_passes_the_level(detector: Detector) -> None:
    """An alarm is declared at the first sample beyond the level, and nowhere else; its leading
    statistic has a label."""
    rng, state, law = (
        np.random.default_rng(4),
        detector.begin(),
        "an alarm is where the statistic first passes the level",
    )
    labels = detector.labels(
        [f"c{i}" for i in range(CHANNELS)], [f"s{i}" for i in range(SIGNATURES)]
    )
    for i in range(PATIENCE):
        followed = detector.follow(state, healthy(rng, 1.0 + i / 10.0))
        beyond = np.flatnonzero(followed.statistic > detector.level)
        require(followed.alarm == (int(beyond[0]) if len(beyond) else None), law, detector.name)
        require((followed.leading is None) == (followed.alarm is None), law, detector.name)
        require(followed.leading is None or bool(labels[followed.leading]), law, detector.name)
        state = followed.state


def it_looks_only_back(detector: Detector) -> None:
    """Later samples of an episode change nothing before them."""
    rng = np.random.default_rng(5)
    for _ in range(PATIENCE):
        episode = healthy(rng)
        later = replace(episode, values=episode.values.copy(), evidence=episode.evidence.copy())
        later.values[episode.window == WINDOWS - 1] *= BROKEN
        later.evidence[WINDOWS - 1, :, 0] *= BROKEN
        before = episode.window < WINDOWS - 1
        one, other = (
            detector.follow(detector.begin(), e).statistic[before] for e in (episode, later)
        )
        # the last sample of a window is where the next may count for the first time
        upto = slice(None, -1)
        require(np.array_equal(one[upto], other[upto]), "it looks only back", detector.name)


def healthy_episodes_alarm_no_more_often_than_promised(detector: Detector) -> None:
    """On fresh healthy episodes alarms are as rare as promised, within the uncertainty of a short
    reference."""
    alarms, hours = _alarms(detector, [1.0] * FRESH)
    require(
        alarms / hours <= SLACK / PROMISE_H,
        "healthy episodes alarm no more often than promised",
        detector.name,
        f"{alarms} alarms",
    )


def what_is_broken_alarms(detector: Detector) -> None:
    """Residuals several times as large raise alarms."""
    alarms, _ = _alarms(detector, [BROKEN] * PATIENCE)
    require(alarms > 0, "what is broken alarms", detector.name)


def _alarms(detector: Detector, sizes: Sequence[float]) -> tuple[int, float]:
    rng, state, alarms = np.random.default_rng(6), detector.begin(), 0
    for size in sizes:
        followed = detector.follow(state, healthy(rng, size))
        state, alarms = followed.state, alarms + (followed.alarm is not None)
    return alarms, len(sizes) * WINDOWS * HORIZON_S / 3600.0


LAWS = (
    the_same_residuals_give_the_same_answer,
    an_alarm_is_where_the_statistic_first_passes_the_level,
    it_looks_only_back,
    healthy_episodes_alarm_no_more_often_than_promised,
    what_is_broken_alarms,
)
