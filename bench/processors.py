"""The same recordings diagnosed as ten kinds of processor would: kernels of linear algebra,
threads, vector instructions, compiled code.

Each kind is a child process with an environment of its own, two at a time; the first is this
machine as it is, and the others' reports are held against its. `CASES` names case folders,
`examples/emps` and `examples/so101` without; `VARIANTS` a part of the kinds, by numbers;
`PUBLISH=1` keeps the table for the pages.
"""

from __future__ import annotations

import json
import os
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from bench.report import Figure, publish, show
from tests.support.processors import (
    ERROR,
    MOVED,
    VARIANTS,
    WIDTH,
    Difference,
    difference,
    processor,
    start,
)

CASES = [Path(c).resolve() for c in os.environ.get("CASES", "examples/emps examples/so101").split()]
CHOSEN = [int(i) for i in os.environ.get("VARIANTS", "").split()] or range(len(VARIANTS))


def main() -> None:
    variants = {name: VARIANTS[name] for i, name in enumerate(VARIANTS) if i in CHOSEN}
    with tempfile.TemporaryDirectory() as temporary:

        def reports(name: str) -> dict:
            out = Path(temporary) / f"{list(variants).index(name)}.json"
            child = start(variants[name], out, CASES)
            _, said = child.communicate()
            if child.returncode:
                raise RuntimeError(f"{name}: {said[-2000:]}")
            return json.loads(out.read_text())

        with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
            found = dict(zip(variants, pool.map(reports, variants), strict=True))
    first, *others = found
    figures, table = [Figure(f"cases diagnosed on {processor()}", str(len(found[first])))], []
    for name in others:
        differences = {
            case: difference(found[first][case], found[name][case]) for case in found[first]
        }
        missed = {case: d for case, d in differences.items() if not d.is_negligible}
        target = f"moved {MOVED:g}, width {WIDTH:g}, error {ERROR:g}"
        figures.append(
            Figure(
                f"{name}: cases that answer alike",
                f"{len(differences) - len(missed)} of {len(differences)}",
                target,
                not missed,
            )
        )
        figures.append(
            Figure("  largest: moved, width, error", " ".join(largest := _largest(differences)))
        )
        table.append([name, f"{len(differences) - len(missed)} of {len(differences)}", *largest])
        figures += [
            Figure(
                f"  {case}",
                f"{'' if d.alike else 'another answer '}{d.moved:.3g} {d.width:.3g} {d.error:.3g}",
            )
            for case, d in missed.items()
        ]
    show("processors: one log, one answer", figures)
    publish("processors", ["arithmetic of", "alike", "estimate", "width", "held-out error"], table)


def _largest(of: dict[str, Difference]) -> list[str]:
    return [
        f"{max(getattr(d, what) for d in of.values()):.2g}" for what in ("moved", "width", "error")
    ]
