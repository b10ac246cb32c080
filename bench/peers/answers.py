"""Answers of a peer on one-joint machines, a file for each case."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

Identify = Callable[[Any], dict[str, float] | None]


def answer_all(identified: Identify) -> None:
    """Answer each `NAME.npz` in the first folder of the command line with `NAME.json` in the
    second: the numbers, or none where the peer cannot say them, and the CPU time [s]."""
    cases, out = Path(sys.argv[1]), Path(sys.argv[2])
    for case in sorted(cases.glob("*.npz")):
        began = time.process_time()
        numbers = identified(np.load(case))
        answer = {"numbers": numbers, "seconds": time.process_time() - began}
        (out / f"{case.stem}.json").write_text(json.dumps(answer))
