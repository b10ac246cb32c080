"""One line for each figure: what, how much, and what it should be; and tables that the pages
show."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

RESULTS = Path(__file__).parent / "results"
LOOP_TURNS = 10_000_000
LOOP_S = 0.5  # at which speed the targets of single figures are meant
MEASURED = Path(__file__).parent.parent / "docs" / "measured"


@dataclass(frozen=True)
class Figure:
    """A figure beside its target; `met` is None for one that has none."""

    what: str
    value: str
    target: str = ""
    met: bool | None = None


def loop_s() -> float:
    """How long a Python loop of ten million turns takes: how fast the machine is just now [s]."""
    began, i = time.perf_counter(), 0
    while i < LOOP_TURNS:
        i += 1
    return time.perf_counter() - began


def show(title: str, figures: list[Figure]) -> None:
    """Print a table, and keep it as JSON."""
    print(f"\n{title}")
    for f in figures:
        mark = {True: "met ", False: "MISS", None: "    "}[f.met]
        print(f"  {mark}  {f.what:<62} {f.value:>22}   {f.target}", flush=True)
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / f"{title.split(maxsplit=1)[0].lower()}.json").write_text(
        json.dumps([asdict(f) for f in figures], indent=1)
    )


def publish(name: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Keep a table for the pages, into which `make docs` writes it, where PUBLISH is set: a part of
    a bench is nothing to publish."""
    if not os.environ.get("PUBLISH"):
        return
    (MEASURED / f"{name}.json").write_text(
        json.dumps({"head": head, "rows": rows}, indent=1, ensure_ascii=False) + "\n"
    )
