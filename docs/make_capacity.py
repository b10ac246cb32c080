"""Write capacity.md: what fleets of several sizes need, computed from what one thing costs.

The costs are what `PUBLISH=1 python -m bench capacity` measured last.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).parent
COSTS = json.loads((HERE / "measured" / "capacity.json").read_text())
DAY_S, YEAR_DAYS = 86_400.0, 365
MIB, GIB, TIB = 1 << 20, 1 << 30, 1 << 40
SHORT_FROM = 10  # numbers from here on are written whole
SIZES = (10, 1_000, 100_000)
# what a robot does
POLL_S = 30.0
RECORDING_MIB = 2.0  # about a minute at 200 Hz with seven channels
UPLOAD_S = 3600.0
DIAGNOSIS_S = 30 * DAY_S
ENTRIES = 3  # of the log for each recording: it came, its look was submitted, and has ended
BUSY = 0.6  # of a core, so that a burst of twice the mean is not felt at once
NETWORK_MIB_S = 110.0  # of 1 Gbit/s


@dataclass(frozen=True)
class Need:
    """What a fleet needs of everything."""

    robots: int
    polls_per_s: float
    uploads_per_s: float
    server_cores: float
    database_cores: float
    worker_cores: float
    connections: int
    server_gib: float
    blobs_tib_a_year: float
    rows_gib_a_year: float
    entries_a_year: float
    shares: dict[str, float]

    @property
    def first(self) -> str:
        """The part that is used most."""
        return max(self.shares, key=lambda part: self.shares[part])


def upload_ms(part: str, mib: float) -> float:
    """What an upload of a size costs a part: a fixed cost, and one for each MiB."""
    short, long = COSTS[f"short_upload_{part}_ms"], COSTS[f"long_upload_{part}_ms"]
    sizes = COSTS["short_upload_bytes"] / MIB, COSTS["long_upload_bytes"] / MIB
    slope = max(0.0, (long - short) / (sizes[1] - sizes[0]))
    return float(short + slope * (mib - sizes[0]))


def need(robots: int) -> Need:
    """What a fleet of a size needs."""
    polls, uploads = robots / POLL_S, robots / UPLOAD_S
    diagnoses = robots / DIAGNOSIS_S
    server_ms = polls * COSTS["poll_server_ms"] + uploads * upload_ms("server", RECORDING_MIB)
    database_ms = (
        polls * COSTS["poll_database_ms"]
        + uploads * upload_ms("database", RECORDING_MIB)
        + uploads * COSTS["watch_database_ms"]
    )
    worker_ms = uploads * COSTS["watch_worker_ms"] + 1e3 * diagnoses * COSTS["diagnosis_worker_s"]
    servers = max(1, math.ceil(server_ms / 1e3 / BUSY))
    yearly = uploads * DAY_S * YEAR_DAYS
    return Need(
        robots,
        polls,
        uploads,
        server_ms / 1e3 / BUSY,
        database_ms / 1e3 / BUSY,
        worker_ms / 1e3 / BUSY,
        robots,
        (servers * COSTS["server_mib"] * MIB + robots * COSTS["held_kib"] * 1024) / GIB,
        yearly * RECORDING_MIB * MIB / TIB,
        yearly * 2 * COSTS["rows_bytes"] / GIB,  # of the upload, and of the watch that follows
        yearly * ENTRIES,
        {
            "the log's head (one writer at a time)": ENTRIES * uploads / COSTS["entries_per_s"],
            "the network of one server": uploads * RECORDING_MIB / NETWORK_MIB_S,
            "one core of a server": server_ms / 1e3,
            "one core of the database": database_ms / 1e3,
            "one core of a worker": worker_ms / 1e3,
        },
    )


def page() -> str:
    """The page's text."""
    fleets = [need(robots) for robots in SIZES]
    return PAGE.format(
        loop=f"{COSTS['loop_s']:.2f}",
        costs=_costs(),
        needs=_needs(fleets),
        shares=_shares(fleets),
        recording=f"{RECORDING_MIB:g}",
        poll=f"{POLL_S:g}",
        busy=f"{100 * BUSY:.0f}",
        held=f"{COSTS['held_kib']:.0f}",
        uploads=f"{COSTS['uploads_per_s']:.0f}",
        entries=f"{COSTS['entries_per_s']:.0f}",
    )


def _costs() -> str:
    rows = [
        ("a poll that finds nothing new (304)", "poll_server_ms", "poll_database_ms", None),
        (
            f"an upload of {COSTS['short_upload_bytes'] / 1024:.0f} KiB",
            "short_upload_server_ms",
            "short_upload_database_ms",
            None,
        ),
        (
            f"an upload of {COSTS['long_upload_bytes'] / MIB:.1f} MiB",
            "long_upload_server_ms",
            "long_upload_database_ms",
            None,
        ),
        ("a version created", "version_server_ms", "version_database_ms", None),
        ("a look at an episode by a monitor", None, "watch_database_ms", "watch_worker_ms"),
    ]
    lines = [
        f"| {what} | " + " | ".join("" if k is None else f"{COSTS[k]:.2g}" for k in keys) + " |"
        for what, *keys in rows
    ]
    diagnosis = f"| a diagnosis of the EMPS | | | {1e3 * COSTS['diagnosis_worker_s']:.0f} |"
    return "\n".join([*lines, diagnosis])


def _needs(fleets: list[Need]) -> str:
    rows = [
        ("polls", [f"{_short(f.polls_per_s)}/s" for f in fleets]),
        ("uploads", [f"{_short(f.uploads_per_s)}/s" for f in fleets]),
        ("cores for servers", [_cores(f.server_cores) for f in fleets]),
        ("cores for PostgreSQL", [_cores(f.database_cores) for f in fleets]),
        ("cores for workers", [_cores(f.worker_cores) for f in fleets]),
        ("connections that robots keep", [f"{f.connections:,}" for f in fleets]),
        ("memory of the servers", [f"{f.server_gib:.2g} GiB" for f in fleets]),
        ("recordings in a year", [_size(f.blobs_tib_a_year * TIB) for f in fleets]),
        ("database, growth in a year", [_size(f.rows_gib_a_year * GIB) for f in fleets]),
        ("entries of the log in a year", [_count(f.entries_a_year) for f in fleets]),
    ]
    return "\n".join(f"| {what} | " + " | ".join(values) + " |" for what, values in rows)


def _shares(fleets: list[Need]) -> str:
    return "\n".join(
        f"| {part} | " + " | ".join(f"{_short(100 * f.shares[part])} %" for f in fleets) + " |"
        for part in fleets[0].shares
    )


def _cores(cores: float) -> str:
    return "a part of one" if cores < 1 else str(math.ceil(cores))


def _short(value: float) -> str:
    """A number with two digits, or whole."""
    return f"{value:,.0f}" if value >= SHORT_FROM else f"{value:.2g}"


def _count(value: float) -> str:
    return f"{_short(value / 1e6)} million"


def _size(size: float) -> str:
    return next(
        f"{_short(size / unit)} {name}"
        for name, unit in (("PiB", 1024 * TIB), ("TiB", TIB), ("GiB", GIB), ("MiB", MIB))
        if size >= unit or name == "MiB"
    )


PAGE = """# Capacity: what a fleet needs

What one thing costs was measured; what a fleet needs is computed from it. Fleets of more than
1,000 robots were not run: their columns are **extrapolated**, and this page says which part would
be full first. `python -m bench load` runs a fleet of 1,000 robots, `PUBLISH=1 python -m bench
capacity` measures the costs anew, and `make docs` computes the page.

## What one thing costs

Milliseconds of one core, on PostgreSQL, on a machine where a Python loop of ten million turns
takes {loop} s (two shared cores, the load generator among them):

| | server | PostgreSQL | worker |
|---|---|---|---|
{costs}

A connection that waits for a change takes {held} KiB of its server. One server took {uploads}
short uploads a second beside the generator and the database, and one log {entries} changes a
second that do nothing else.

## What a fleet does

A robot asks every {poll} s whether its model has changed, or keeps a connection that waits, sends a
recording of {recording} MiB an hour that a monitor looks at, and is diagnosed once a month. Cores
are counted at {busy} % use. Change the numbers at the top of `docs/make_capacity.py` for a fleet of
your own.

| | 10 robots | 1,000 robots | 100,000 robots (extrapolated) |
|---|---|---|---|
{needs}

## Which part is full first

The share of each that the fleet takes, of one core, one network of 1 Gbit/s, and of the writes that
one log takes:

| | 10 robots | 1,000 robots | 100,000 robots (extrapolated) |
|---|---|---|---|
{shares}

- **Servers** are added freely: they share nothing but the database and the store. Above 100 %, add
  servers (or `--processes`), each with a network of its own.
- **Workers** are added freely, too; scale them by `trueup_jobs`.
- **PostgreSQL** runs on one machine. A poll reads one row by its key, to check whether the serving
  version has changed. Most of the database's work is the uploads and the monitor's evaluation
  of each. It needs as many cores as the table says, and a disk whose sync takes a millisecond or
  less.
- **The log's head is one row**, which every change waits for until the change before it has
  committed: this does not grow with cores, only with a faster disk. Its share is counted against
  the changes that one log took here, three for each recording. When it nears 100 %, split the
  fleet by site into several installations, each with a log of its own; `trueup export` and
  `import` move plants between them.
- **Recordings** are most of what is stored. Lifecycle rules of the store may move old ones to
  colder storage as long as they stay readable; nothing else refers to them than their digest.

## A load test for machines that are not at hand

What to run before a fleet of this size is relied on, and what it should show:

1. 1,000 robots on the machines that will serve: `ROBOTS=1000 FLEET_S=600 python -m bench load`.
   p99 of a poll under 20 ms, of an upload under 500 ms, no other answers, nothing left to watch
   after 10 s.
2. Ten times as many, from several machines (one generator holds about 5,000 connections). The
   server's cores, the database's and `pg_stat_statements` should have grown ten times; if the
   database's grew more, look at the index of the slowest statement first.
3. The log's head: uploads as fast as they go at 64 connections over two servers. The
   share of the log's head in the table above is relative to this rate. The rate should not fall
   when a third server is added.
4. Loss: kill a server, a worker and the database's primary in turn during 2. `trueup fsck`
   afterwards must find nothing.
5. `trueup fsck --drill` with a month of recordings: how long a restore takes.
"""

if __name__ == "__main__":
    (HERE / "capacity.md").write_text(page())
