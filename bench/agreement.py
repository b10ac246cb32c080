"""Whether intervals hold what one more recording shows, on recordings of real machines.

Each machine is diagnosed. Then each of its recordings in turn is left out: the answer's composition
is fitted to all others together, and to the one alone; the interval of the others holds if both
intervals meet as far as independent ones would 95 times in 100. It is counted without and with what
recordings differ by, which the recording that is left out has no part in. `CASES` names case
folders, or folders of them.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from bench.report import Figure, show
from trueup.diagnose.between_recordings import Agreement, Excess, alone
from trueup.diagnose.case import read_case
from trueup.diagnose.diagnosis import Diagnosis, diagnose
from trueup.diagnose.intervals import half_widths
from trueup.diagnose.processes import in_processes
from trueup.model.series import Series

CASES = os.environ.get("CASES", "tests/real:examples").split(os.pathsep)
MOST = 12  # recordings; of more every third is left out
FEWEST = 3


def cases() -> list[Path]:
    """The case folders among CASES and in them."""
    roots = [Path(name) for name in CASES]
    return sorted(
        p.parent for root in roots for p in {*root.glob("plant.json"), *root.glob("*/plant.json")}
    )


def left_out(diagnosis: Diagnosis) -> Iterator[tuple[bool, bool]]:
    """For each recording left out and each number: whether the others' interval holds without and
    with what they differ by."""
    fit, fits = diagnosis.choice.winner.fit, diagnosis.search.problem.fits
    data = [*fits.adaptation, *fits.validation]
    single = alone(fits, fit, {s.digest: [s] for s in data})
    if len(data) < FEWEST:
        return
    for s in data[:: 3 if len(data) > MOST else 1]:
        if s.digest in single:
            yield from _held(diagnosis, s, [other for other in data if other is not s])


def _held(diagnosis: Diagnosis, s: Series, others: Sequence[Series]) -> Iterator[tuple[bool, bool]]:
    fit, fits = diagnosis.choice.winner.fit, diagnosis.search.problem.fits
    subsets = {other.digest: [other] for other in others}
    fitted = alone(fits, fit, {"all": others, s.digest: [s], **subsets})
    if "all" not in fitted or s.digest not in fitted:
        return
    together, its = fitted.pop("all"), fitted.pop(s.digest)
    agreement, own = Agreement.of(together, fitted), Excess.of(together).halves(its)
    halves = half_widths(together, together)
    for name, x, y in zip(
        together.free.names,
        together.free.at(together.values),
        its.free.at(its.values),
        strict=True,
    ):
        if name in agreement.by_number and np.isfinite(own[name]):
            narrow = np.hypot(halves[name], own[name])
            wide = np.hypot(narrow, agreement.by_number[name].half)
            yield bool(abs(x - y) <= narrow), bool(abs(x - y) <= wide)


def main() -> None:
    """Count, and print."""
    figures: list[Figure] = []
    held: list[tuple[bool, bool]] = []
    for case in cases():
        plant, episodes = read_case(case)
        rows = list(left_out(diagnose(plant, episodes, solve=in_processes)))
        held += rows
        figures.append(Figure(case.name, _share(rows), ""))
    show(
        "intervals that hold a recording left out", [*figures, Figure("all", _share(held), "95 %")]
    )


def _share(rows: Sequence[tuple[bool, bool]]) -> str:
    if not rows:
        return "nothing to compare"
    without, with_it = (100.0 * float(np.mean(column)) for column in zip(*rows, strict=True))
    return (
        f"{without:.1f} % without, {with_it:.1f} % with what recordings differ by, of {len(rows)}"
    )


if __name__ == "__main__":
    main()
