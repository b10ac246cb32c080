"""Help: do the tasks of somebody else's diagnosis, from a parcel and the same episodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trueup.canonical import digest_of_bytes
from trueup.diagnose.admission import admit
from trueup.diagnose.decide import selection_criteria
from trueup.diagnose.laying_out import by_role, laid_out
from trueup.diagnose.parcel import Outline, pack_answers, unpack_tasks
from trueup.diagnose.problem import Problem
from trueup.diagnose.task import in_threads
from trueup.episode.episode import Episode
from trueup.model.plant import Plant


class Helper:
    """Knows one diagnosis's plant and episodes, and lays out each problem of it once."""

    def __init__(self, plant: Plant, episodes: Sequence[Episode]) -> None:
        self._plant = plant
        self._adaptation, self._validation = by_role(episodes)
        self._admission = admit(plant, self._adaptation)
        self._criteria = selection_criteria(plant, [*self._adaptation, *self._validation])
        self._known: tuple[str, Problem] | None = None

    def answer(self, parcel: str) -> str:
        """What the tasks of a parcel answer, packed. Raises what unpacking does."""
        outline, tasks = unpack_tasks(parcel)
        return pack_answers(in_threads(self._problem(outline), tasks, lambda _: None))

    def _problem(self, outline: Outline) -> Problem:
        numbers = outline.base.values, outline.sigma, outline.correlation
        told = repr((outline.scheme, outline.length_s, outline.base.cost)).encode()
        name = digest_of_bytes(told + b"".join(x.tobytes() for x in numbers))
        if self._known is None or self._known[0] != name:
            sigma = np.where(np.isfinite(outline.sigma), outline.sigma, np.nan)
            admission = replace(self._admission, sigma=sigma, correlation=outline.correlation)
            problem = laid_out(
                self._plant,
                admission,
                self._adaptation,
                self._validation,
                self._criteria,
                outline.scheme,
                outline.length_s,
                outline.base,
            )
            self._known = name, problem
        return self._known[1]
