"""An isolated process that diagnoses case folders without their labels.

It is started with an almost empty environment, reads the paths of folders from its standard input,
and answers each with one line of JSON. The labels are in the memory of the process that started it,
and nowhere else.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

NO_ANSWER = "no-answer"
# What a process needs to find its libraries and its cache.
PASSED_ON = ("PATH", "HOME", "TMPDIR", "NUMBA_CACHE_DIR", "LANG")


class IsolatedProcess:
    """An isolated process on one core, as the `Diagnose` of a blind trial. Use it in a `with`
    block."""

    def __init__(self, core: int) -> None:
        self._core = core
        self._process = self._start()

    def _start(self) -> subprocess.Popen[str]:
        environment = {name: os.environ[name] for name in PASSED_ON if name in os.environ}
        command = [sys.executable, "-I", "-m", "trueup_worker.isolated_process", str(self._core)]
        pipe = subprocess.PIPE
        return subprocess.Popen(
            command,
            stdin=pipe,
            stdout=pipe,
            env=environment,
            cwd="/",
            text=True,
            start_new_session=True,
        )

    def __call__(self, folder: Path) -> Mapping[str, Any]:
        """Diagnoses a case folder. A process that ends without an answer is started once more.

        Returns `report`, `manifest` and `arrays` (base64), or `problem`; and `seconds`.
        """
        answer = self._ask(folder)
        if answer is None:
            self._close()
            self._process = self._start()
            answer = self._ask(folder)
        return answer or {
            "problem": (
                f"{NO_ANSWER}: the diagnosing process ended with code {self._process.wait()}"
            ),
            "seconds": 0.0,
        }

    def _ask(self, folder: Path) -> Mapping[str, Any] | None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with suppress(BrokenPipeError):  # it has ended, and its answer is empty
            self._process.stdin.write(json.dumps(str(folder.resolve())) + "\n")
            self._process.stdin.flush()
        try:
            answer: dict[str, Any] = json.loads(self._process.stdout.readline())
        except json.JSONDecodeError:
            return None
        return answer

    def _close(self) -> None:
        self._process.kill()
        with suppress(BrokenPipeError), self._process:  # closes its pipes, and waits
            pass

    def __enter__(self) -> IsolatedProcess:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._close()


def main() -> None:
    """Diagnoses folders until the standard input ends."""
    from trueup.blindtrial.diagnosing import answer_of  # noqa: PLC0415  (loads what a parent need not)

    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {int(sys.argv[1])})
    answers, sys.stdout = sys.stdout, sys.stderr  # whatever prints must not spoil an answer
    for line in sys.stdin:
        answer = answer_of(Path(json.loads(line)), time.monotonic)
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


if __name__ == "__main__":
    main()
