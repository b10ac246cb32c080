"""`trueup jobs`: what is under way and behind what it waits, what has ended, and why it failed."""

from __future__ import annotations

from datetime import UTC, datetime
from itertools import islice
from typing import Annotated, Any

from cyclopts import Parameter

from trueup_cli.digests import resolve
from trueup_cli.options import DEFAULT_URL, Json, PlantName, Url, connect
from trueup_cli.show import as_json, moment, say, table
from trueup_client import Client
from trueup_client.records import Job, QueuedJob
from trueup_pages.jobs import about, name_of

ENDED = 20  # jobs of a plant that are printed
SOUGHT = 1000  # of a plant's newest jobs, among which a prefix is sought
WHOLE = 32  # digits of an id
FINAL = ("succeeded", "failed", "cancelled")


def jobs(
    plant: PlantName | None = None,
    *,
    show: Annotated[
        str | None, Parameter(help="Id of a job, or its first digits: what became of it, and why")
    ] = None,
    cancel: Annotated[
        str | None, Parameter(help="Id of a job to cancel, or its first digits")
    ] = None,
    url: Url = DEFAULT_URL,
    as_json_: Json = False,
) -> None:
    """Show the jobs that are under way, and of a plant those that have ended; or cancel one."""
    client = connect(url)
    if cancel is not None or show is not None:
        job = _job_named(client, plant, str(cancel or show))
        record = client.job(job) if cancel is None else client.cancel(job)
        as_json(record) if as_json_ else _show(record)
        return
    queue = [q for q in client.queue() if plant in (None, q["plant"])]
    ended = (
        [j for j in islice(client.jobs(plant), ENDED) if j["state"] in FINAL]
        if plant is not None
        else []
    )
    if as_json_:
        as_json([*queue, *ended])
        return
    if not queue and not ended:
        say("nothing is under way")
    if queue:
        table(
            "Under way",
            ["job", "kind", "plant", "progress", "stands"],
            [
                (
                    q["id"][:12],
                    name_of(q["kind"]),
                    q["plant"],
                    f"{100 * q['progress']:.0f} %, {q['stage']}",
                    _standing(q),
                )
                for q in queue
            ],
        )
    if ended:
        table(
            "Ended",
            ["job", "kind", "state", "ended", "submitted by"],
            [
                (
                    j["id"][:12],
                    name_of(j["kind"]),
                    j["state"],
                    moment(j["updated_at"]),
                    j["created_by"],
                )
                for j in ended
            ],
        )


def _standing(q: QueuedJob) -> str:
    if q["begun_at"] is not None:
        ran = (datetime.now(UTC) - datetime.fromisoformat(q["begun_at"])).total_seconds()
        takes = f", such jobs take {about(q['takes_s'])}" if q["takes_s"] is not None else ""
        return f"at worker {q['worker']} for {ran:.0f} s{takes}"
    if not q["ahead"]:
        return "a worker takes it next"
    waits = f", {about(q['waits_s'])}" if q["waits_s"] is not None else ""
    return f"behind {q['ahead']} job{'s' if q['ahead'] > 1 else ''}{waits}"


def _job_named(client: Client, plant: str | None, prefix: str) -> str:
    """Returns the id of the one job whose id begins so. Raises NoSuchDigest."""
    if len(prefix) == WHOLE:
        return prefix
    listed: list[str] = [q["id"] for q in client.queue()]
    listed += [j["id"] for j in islice(client.jobs(plant), SOUGHT)] if plant is not None else []
    return resolve(prefix, listed, "job", f"trueup jobs {plant or 'PLANT'}")


def _show(job: Job) -> None:
    say(
        "job [bold]{}[/]: {} of {}, {}", job["id"], name_of(job["kind"]), job["plant"], job["state"]
    )
    say("submitted {} by {}", moment(job["created_at"]), job["created_by"])
    problem: dict[str, Any] | None = (job["result"] or {}).get("problem")
    if problem is None:
        say("{:.0f} %, {}", 100 * job["progress"], job["stage"])
        return
    say("[red]{}[/] ({})", problem["detail"], problem["code"])
    say("{}", problem.get("hint") or "")
    for name, value in (problem.get("facts") or {}).items():
        for line in str(value).splitlines():
            say("  {}: {}", name, line)
