"""Compare two models on recordings that neither was fitted to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from trueup.artifact.model import Model
from trueup.episode.episode import Episode
from trueup.episode.role import HELD_OUT, Role
from trueup.errors import NotAnEpisode
from trueup.fit.score import EVERY, Scoring, rollout_rms, score
from trueup.gate.interval import Pairs, ratio_interval
from trueup.model.plant import Plant
from trueup.model.predictor import Nominal, Predictor
from trueup.notebook.case import Case
from trueup.notebook.diagnosis import Diagnosis

Compared = Model | Diagnosis | Plant


@dataclass(frozen=True)
class Comparison:
    """The errors of two models over rollouts of `horizon_s` [s] on held-out episodes.

    `rms` holds of each observation by name the root mean square error of the first and of the
    second model, in its own unit; `ratio` the first one's mean error over the second's, each
    observation in its declared scale, with its 95 % interval over other windows like these, None
    where there are too few; `by_episode` the two mean errors of each episode by its digest.
    """

    horizon_s: float
    rms: Mapping[str, tuple[float, float]]
    units: Mapping[str, str]
    ratio: float
    ci95: tuple[float, float] | None
    by_episode: Mapping[str, tuple[float, float]]

    @property
    def sentence(self) -> str:
        """What the figures say."""
        width = "" if self.ci95 is None else f" (95 %: {self.ci95[0]:.3g} to {self.ci95[1]:.3g})"
        better, worse = self.ci95 or (self.ratio, self.ratio)
        verdict = (
            "the first predicts better"
            if worse < 1.0
            else "the second predicts better"
            if better > 1.0
            else "the recordings do not tell them apart"
        )
        count = len(self.by_episode)
        episodes = "1 episode" if count == 1 else f"{count} episodes"
        return (
            f"Over {self.horizon_s:g} s on {episodes} the first model's error is {self.ratio:.3g} "
            f"of the second's{width}: {verdict}."
        )

    def __repr__(self) -> str:
        rows = [
            f"  {name}: {first:.4g} and {second:.4g} {self.units[name]}".rstrip()
            for name, (first, second) in self.rms.items()
        ]
        return "\n".join([self.sentence, *rows])

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><td>{escape(name)} [{escape(self.units[name])}]</td><td>{first:.4g}</td>"
            f"<td>{second:.4g}</td></tr>"
            for name, (first, second) in self.rms.items()
        )
        return (
            f"<p><strong>{escape(self.sentence)}</strong></p><table><thead><tr><th>RMS error</th>"
            f"<th>first</th><th>second</th></tr></thead><tbody>{rows}</tbody></table>"
        )


def compare(
    first: Compared, second: Compared, case: Case, *, horizon_s: float | None = None
) -> Comparison:
    """Compare two models on the held-out episodes of a case.

    A model is what `trueup.load` returns, a diagnosis, or a plant, which stands for its nominal
    model. `horizon_s` [s] is the length of rollouts, by default the plant's. Raises NotAnEpisode
    where the case holds nothing out.
    """
    held_out = [e for e in case.episodes if e.role in (*HELD_OUT, Role.TEST)]
    if not held_out:
        raise NotAnEpisode(
            "the case holds no episode out",
            rule="role",
            hint="Give one the role validation: what a model was fitted to says nothing of it.",
        )
    horizon = horizon_s or case.plant.horizon_s
    both = [_predictor(of) for of in (first, second)]
    scores = [score(p, held_out, Scoring(horizon, EVERY)) for p in both]
    pairs = [
        Pairs(a.rollout, b.rollout, a.samples)
        for a, b in zip(scores[0].windows, scores[1].windows, strict=True)
    ]
    rms = np.array([_rms(p, held_out, horizon) for p in both])
    channels = case.plant.layout.observations
    return Comparison(
        horizon,
        {c.name: (float(rms[0, i]), float(rms[1, i])) for i, c in enumerate(channels)},
        {c.name: c.unit for c in channels},
        float(scores[0].rollout.mean() / scores[1].rollout.mean()),
        ratio_interval(pairs),
        {
            e.digest: (float(a), float(b))
            for e, a, b in zip(held_out, scores[0].rollout, scores[1].rollout, strict=True)
        },
    )


def _predictor(of: Compared) -> Predictor:
    if isinstance(of, Diagnosis):
        return of.model.predictor
    return Nominal(of) if isinstance(of, Plant) else of.predictor


def _rms(predictor: Predictor, episodes: Sequence[Episode], horizon_s: float) -> np.ndarray:
    """Over all episodes alike, `(observations,)`."""
    each = np.array([rollout_rms(predictor, e, horizon_s) for e in episodes])
    return np.asarray(np.sqrt(np.mean(each**2, axis=0)))
