"""Why a job ends without a result, beyond what its own computing raises."""

from __future__ import annotations

from trueup.canonical import Json
from trueup.errors import TrueupError


class ProcessDied(TrueupError):
    """The process or the worker died each time that the job was begun."""

    code = "process-died"
    hint = (
        "Read what is known of the last attempt: a job that runs out of memory needs a worker with "
        "more, a crash in compiled code is worth a report. Then submit it again."
    )


class MemoryLimit(TrueupError):
    """The job needs more memory than its process may hold."""

    code = "memory-limit"
    hint = "Raise TRUEUP_JOB_MEMORY_LIMIT_BYTES at the workers, or submit it with fewer episodes."


class TimeLimit(TrueupError):
    """The job took longer than it may."""

    code = "time-limit"
    hint = "Raise TRUEUP_JOB_TIME_LIMIT_S at the workers, or submit it with fewer episodes."


def problem_of(error: TrueupError) -> dict[str, Json]:
    """Returns an error as the problem of a job."""
    return {
        "code": error.code,
        "detail": error.message,
        "hint": error.hint,
        "facts": {k: str(v) for k, v in error.facts.items()},
    }
