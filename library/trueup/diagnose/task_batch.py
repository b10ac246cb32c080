"""Task batch: tasks and what they answer as text, from one process to another; every number comes
out as it went in, bit for bit.

A line of JSON, then the bytes of the arrays that it refers to, each once however often it occurs;
compressed, and as base64 for engines that keep text.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from trueup.diagnose.candidate import Candidate
from trueup.diagnose.search_problem import SearchProblem
from trueup.diagnose.tasks import Converge, Fit, Screen, Task
from trueup.fit.free_numbers import Free
from trueup.fit.rollout_fit import RolloutFit, Start
from trueup.model.hypothesis import Hypothesis
from trueup.model.series import Scheme

Array = NDArray[np.float64]
KINDS = {"<f8": np.float64, "<i8": np.int64}  # of the numbers that fits hold
LARGEST = 256 << 20  # bytes of what a batch unfolds to
FAST = 1  # the level of compression: a batch is read once


@dataclass(frozen=True, slots=True)
class Outline:
    """From what others lay out the same problem: the scheme, the windows' length [s], what counts
    as noise and its correlation `(2 x joints,)`, and the nominal form refitted.
    """

    scheme: Scheme
    length_s: float
    sigma: Array
    correlation: Array
    base: RolloutFit


def pack_tasks(problem: SearchProblem, tasks: Sequence[Task]) -> str:
    """A problem's outline and some tasks. Its text is the same whenever they are."""
    packing = _Packing()
    outline = {
        "alpha": problem.scheme.alpha,
        "parts": problem.scheme.parts,
        "ramped": problem.scheme.ramped,
        "length_s": problem.fits.length_s,
        "noise": [packing.array(problem.fitter.sigma), packing.array(problem.fitter.correlation)],
        "base": packing.fit(problem.base),
    }
    return packing.text({"outline": outline, "tasks": [_task(packing, task) for task in tasks]})


def unpack_tasks(text: str) -> tuple[Outline, list[Task]]:
    """Outline and tasks as they were packed. Raises ValueError, KeyError, TypeError or zlib.error
    where the text is none of ours."""
    message, unpacking = _Unpacking.of(text)
    outlined = message["outline"]
    sigma, correlation = (unpacking.array(at) for at in outlined["noise"])
    outline = Outline(
        Scheme(outlined["alpha"], outlined["parts"], outlined["ramped"]),
        outlined["length_s"],
        sigma,
        correlation,
        unpacking.fit(outlined["base"]),
    )
    return outline, [_task_of(unpacking, task) for task in message["tasks"]]


def pack_answers(answers: Sequence[Any]) -> str:
    """What tasks answered: a candidate each, or the fits of a race."""
    packing = _Packing()
    return packing.text(
        [
            _candidate(packing, a) if isinstance(a, Candidate) else [packing.fit(fit) for fit in a]
            for a in answers
        ]
    )


def unpack_answers(text: str) -> list[Any]:
    """Answers as they were packed. Raises what `unpack_tasks` does."""
    message, unpacking = _Unpacking.of(text)
    return [
        _candidate_of(unpacking, a) if isinstance(a, dict) else [unpacking.fit(fit) for fit in a]
        for a in message
    ]


def _task(packing: _Packing, task: Task) -> dict[str, Any]:
    if isinstance(task, Screen):
        return {
            "screen": task.term,
            "parent": packing.fit(task.parent),
            "expected": packing.array(task.expected),
        }
    if isinstance(task, Fit):
        return {
            "fit": task.term,
            "parent_cost": _number(task.parent_cost),
            "screened": [packing.fit(fit) for fit in task.screened],
        }
    return {"converge": _candidate(packing, task.candidate)}


def _task_of(unpacking: _Unpacking, message: Mapping[str, Any]) -> Task:
    if "screen" in message:
        return Screen(
            unpacking.fit(message["parent"]),
            message["screen"],
            unpacking.array(message["expected"]),
        )
    if "fit" in message:
        return Fit(
            float.fromhex(message["parent_cost"]),
            message["fit"],
            [unpacking.fit(fit) for fit in message["screened"]],
        )
    return Converge(_candidate_of(unpacking, message["converge"]))


def _candidate(packing: _Packing, candidate: Candidate) -> dict[str, Any]:
    return {
        "fit": packing.fit(candidate.fit),
        "check": packing.fit(candidate.check),
        "resolved": candidate.resolved,
    }


def _candidate_of(unpacking: _Unpacking, message: Mapping[str, Any]) -> Candidate:
    return Candidate(
        unpacking.fit(message["fit"]), unpacking.fit(message["check"]), message["resolved"]
    )


def _number(value: float) -> str:
    """A number exactly, with those that JSON has not."""
    return float(value).hex()


@dataclass(slots=True)
class _Packing:
    """What stands once: arrays by their bytes, fits by who they are."""

    arrays: dict[tuple[str, tuple[int, ...], bytes], int] = field(default_factory=dict)
    fits: list[dict[str, Any]] = field(default_factory=list)
    known: dict[int, tuple[int, RolloutFit]] = field(default_factory=dict)

    def array(self, given: NDArray[Any]) -> int:
        """The place of an array."""
        plain = np.ascontiguousarray(given)
        kind = next(name for name, of in KINDS.items() if plain.dtype == of)
        return self.arrays.setdefault((kind, plain.shape, plain.tobytes()), len(self.arrays))

    def fit(self, given: RolloutFit) -> int:
        """The place of a fit."""
        if id(given) not in self.known:
            self.fits.append(self._fit(given))
            self.known[id(given)] = len(self.fits) - 1, given
        return self.known[id(given)][0]

    def _fit(self, fit: RolloutFit) -> dict[str, Any]:
        free = fit.free
        return {
            "effects": fit.hypothesis.effects,
            "values": self.array(fit.values),
            "free": [
                free.names,
                *(self.array(x) for x in (free.rows, free.step, free.low, free.high, free.along)),
            ],
            "starts": [
                [
                    digest,
                    self.array(start.windows),
                    [[*key, _number(x)] for key, x in start.memory.items()],
                ]
                for digest, start in fit.starts.items()
            ],
            "cost": _number(fit.cost),
            "costs": self.array(fit.costs),
            "samples": fit.samples,
            "information": self.array(fit.information),
            "converged": bool(fit.converged),
            "scores": self.array(fit.scores),
            "distance": None if fit.distance is None else _number(fit.distance),
        }

    def text(self, given: Any) -> str:
        """All of it."""
        arrays = [[kind, shape] for kind, shape, _ in self.arrays]
        line = orjson.dumps({"arrays": arrays, "fits": self.fits, "given": given})
        packed = b"\n".join([line, b"".join(data for _, _, data in self.arrays)])
        return base64.b64encode(zlib.compress(packed, FAST)).decode()


@dataclass(frozen=True, slots=True)
class _Unpacking:
    """Arrays and fits of a text, by their places."""

    arrays: list[NDArray[Any]]
    fits: list[RolloutFit]

    @staticmethod
    def of(text: str) -> tuple[Any, _Unpacking]:
        """What was given, and what it refers to."""
        unfolding = zlib.decompressobj()
        whole = unfolding.decompress(base64.b64decode(text, validate=True), LARGEST)
        if not unfolding.eof:
            raise ValueError(f"a batch unfolds to more than {LARGEST} bytes, or is cut off")
        line, _, data = whole.partition(b"\n")
        message = orjson.loads(line)
        counts = [int(np.prod(shape)) for _, shape in message["arrays"]]
        begins = [8 * sum(counts[:i]) for i in range(len(counts))]
        arrays = [
            np.frombuffer(data, KINDS[kind], count, begin).reshape(shape).copy()
            for (kind, shape), count, begin in zip(message["arrays"], counts, begins, strict=True)
        ]
        unpacking = _Unpacking(arrays, [])
        unpacking.fits.extend(unpacking._fit(fit) for fit in message["fits"])
        return message["given"], unpacking

    def array(self, at: int) -> NDArray[Any]:
        """The array at a place."""
        return self.arrays[at]

    def fit(self, at: int) -> RolloutFit:
        """The fit at a place."""
        return self.fits[at]

    def _fit(self, message: Mapping[str, Any]) -> RolloutFit:
        names, *of_free = message["free"]
        rows, step, low, high, along = (self.arrays[at] for at in of_free)
        return RolloutFit(
            Hypothesis(tuple(message["effects"])),
            self.arrays[message["values"]],
            Free(rows, tuple((owner, name) for owner, name in names), step, low, high, along),
            {
                digest: Start(
                    self.arrays[windows],
                    {(term, state): float.fromhex(x) for term, state, x in memory},
                )
                for digest, windows, memory in message["starts"]
            },
            float.fromhex(message["cost"]),
            self.arrays[message["costs"]],
            message["samples"],
            self.arrays[message["information"]],
            message["converged"],
            self.arrays[message["scores"]],
            None if message["distance"] is None else float.fromhex(message["distance"]),
        )
