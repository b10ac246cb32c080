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
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

NO_ANSWER = "no-answer"
ATTEMPTS = 2  # at a case, of which the second is in a new process
# What a process needs to find its libraries and its cache, and how many threads a matrix takes.
PASSED_ON = ("PATH", "HOME", "TMPDIR", "NUMBA_CACHE_DIR", "OPENBLAS_NUM_THREADS", "LANG")


class IsolatedProcess:
    """An isolated process on one core, as the `Diagnose` of a blind trial. Use it in a `with`
    block."""

    def __init__(self, core: int) -> None:
        self._core = core
        self._process: subprocess.Popen[str] | None = None

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

    def __call__(self, folder: Path, limit_s: float | None = None) -> Mapping[str, Any]:
        """Diagnoses a case folder, in a time limit [s]. A process that ends without an answer is
        started once more.

        Returns `report`, `manifest` and `arrays` (base64), or `problem`; and `seconds`.
        """
        for _ in range(ATTEMPTS):
            process = self._process = self._process or self._start()
            limit = threading.Timer(limit_s, process.kill) if limit_s is not None else None
            if limit is not None:
                limit.start()
            answer = _asked(process, folder)
            if limit is not None:
                limit.cancel()
            if answer is not None:
                return answer
            code = process.wait()
            self.close()
        problem = f"{NO_ANSWER}: the diagnosing process ended with code {code}"
        return {"problem": problem, "seconds": 0.0}

    def close(self) -> None:
        """Ends the process, if there is one."""
        if self._process is not None:
            self._process.kill()
            with suppress(BrokenPipeError), self._process:  # closes its pipes, and waits
                pass
            self._process = None

    def __enter__(self) -> IsolatedProcess:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _asked(process: subprocess.Popen[str], folder: Path) -> Mapping[str, Any] | None:
    """A process's answer, None where it ended before."""
    assert process.stdin is not None
    assert process.stdout is not None
    with suppress(BrokenPipeError):  # it has ended, and its answer is empty
        process.stdin.write(json.dumps(str(folder.resolve())) + "\n")
        process.stdin.flush()
    try:
        answer: dict[str, Any] = json.loads(process.stdout.readline())
    except json.JSONDecodeError:
        return None
    return answer


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
