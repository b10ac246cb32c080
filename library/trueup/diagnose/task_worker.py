"""Task worker: does the tasks of somebody else's diagnosis, from a batch and the same episodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trueup.canonical import digest_of_bytes
from trueup.diagnose.data_quality import assess
from trueup.diagnose.problem_setup import Recordings, Setup
from trueup.diagnose.search_problem import SearchProblem
from trueup.diagnose.task_batch import Outline, pack_answers, unpack_tasks
from trueup.diagnose.tasks import in_threads
from trueup.episode.episode import Episode
from trueup.model.plant import Plant


class TaskWorker:
    """Knows one diagnosis's plant and episodes, and sets up each problem of it once."""

    def __init__(self, plant: Plant, episodes: Sequence[Episode]) -> None:
        self._recordings = Recordings.of(plant, episodes)
        self._quality = assess(plant, self._recordings.adaptation)
        self._known: tuple[str, SearchProblem] | None = None

    def answer(self, batch: str) -> str:
        """What the tasks of a batch answer, packed. Raises what unpacking does."""
        outline, tasks = unpack_tasks(batch)
        return pack_answers(in_threads(self._problem(outline), tasks, lambda _: None))

    def _problem(self, outline: Outline) -> SearchProblem:
        numbers = outline.base.values, outline.sigma, outline.correlation
        described = repr((outline.scheme, outline.length_s, outline.base.cost)).encode()
        name = digest_of_bytes(described + b"".join(x.tobytes() for x in numbers))
        if self._known is None or self._known[0] != name:
            sigma = np.where(np.isfinite(outline.sigma), outline.sigma, np.nan)
            quality = replace(self._quality, sigma=sigma, correlation=outline.correlation)
            setup = Setup(self._recordings, quality, outline.scheme)
            self._known = name, setup.problem_again(outline.length_s, outline.base)
        return self._known[1]
