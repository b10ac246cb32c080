"""Computing: which process computes what, and what becomes of a process that dies."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from trueup.cores import own_cores
from trueup_service.actions import find
from trueup_service.open_telemetry import observe
from trueup_service.registry.records import JobState
from trueup_service.registry.transaction import reading, writing
from trueup_service.wiring import Parts
from trueup_worker.compute_process import ComputeProcess, OutOfTime, Pool, ProcessEnded
from trueup_worker.isolated_process import IsolatedProcess
from trueup_worker.job_problems import TimeLimit, problem_of
from trueup_worker.trial_case import diagnose_case


class Computing:
    """The compute processes of one worker: one for jobs, one for looks at new episodes, and one on
    each core for parts of jobs."""

    def __init__(self, parts: Parts, worker: str) -> None:
        self._parts, self._worker = parts, worker
        self._jobs, self._watching = (Pool([ComputeProcess(parts)]) for _ in range(2))
        self._pieces = Pool([ComputeProcess(parts, core) for core in own_cores()])
        self._isolated = Pool([IsolatedProcess(core) for core in own_cores()])

    def warm_up(self) -> None:
        """Starts the process for jobs, so that the first job need not wait for it."""
        with self._jobs.one() as process:
            process.start()

    def compute(self, job_id: str) -> dict[str, Any]:
        """Computes a job, as `run_job.compute` does."""
        with self._pool(job_id).one() as process:
            try:
                computed = self._tried(process, job_id, "compute", job_id, self._worker)
            except OutOfTime:
                return {"state": JobState.FAILED.value, "problem": problem_of(TimeLimit())}
        return dict(computed)

    def finish(self, job_id: str, computed: dict[str, Any]) -> str:
        """Finishes a job, as `run_job.finish` does."""
        with self._pool(job_id).one() as process:
            return str(process.ask("finish", job_id, computed))

    def part(self, entry: str, job_id: str, asked: Any) -> dict[str, Any]:
        """Computes a part of a job, as `run_job.part` does; a case of a blind trial is diagnosed in
        a process that has no access to anything else."""
        if self._kind(job_id) == "blindtrial":
            with self._isolated.one() as isolated:
                return {"answer": diagnose_case(self._parts, isolated, asked)}
        with self._pieces.one() as process:
            try:
                answer = self._tried(process, entry, "part", entry, job_id, asked, self._worker)
            except OutOfTime:
                return {"problem": problem_of(TimeLimit())}
        return dict(answer)

    def rest(self) -> None:
        """Ends the processes for parts of jobs, which the next part starts again."""
        self._pieces.close()
        self._isolated.close()

    def _tried(self, process: ComputeProcess, entry: str, call: str, *arguments: Any) -> Any:
        """Asks again where the process died, as long as the job may be begun again."""
        for _ in range(self._parts.settings.job_attempts):
            try:
                return process.ask(call, *arguments)
            except ProcessEnded as error:
                with writing(self._parts.database) as tx:
                    tx.attempts.end(entry, self._worker, f"{error.how}\n{error.traceback}")
        return process.ask(call, *arguments)  # which says that it was begun often enough

    def _pool(self, job_id: str) -> Pool[ComputeProcess]:
        return self._watching if self._kind(job_id) == "watch" else self._jobs

    def _kind(self, job_id: str) -> str:
        with reading(self._parts.database) as tx:
            return find.job(tx, job_id).kind


def tell_of_job(parts: Parts, span: Any, job_id: str) -> None:
    """Puts what became of a job, and how long it waited and took, into its span and the metrics."""
    with reading(parts.database) as tx:
        job = find.job(tx, job_id)
    labels = {"trueup.job.kind": job.kind, "trueup.job.state": str(job.state)}
    span.update_name(f"job {job.kind}")
    span.set_attributes({**labels, "trueup.plant": job.plant})
    begin, end = map(datetime.fromisoformat, (job.created_at, job.updated_at))
    observe("trueup.job.duration", "From submission to end", (end - begin).total_seconds(), labels)
