"""What pages cost: the server's time for each at 10^5 plants, and 10^5 versions and
episodes of one, and a diagnosis in a real browser."""

from __future__ import annotations

import json
import sqlite3
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

import numpy as np

from bench.growth import fill
from bench.report import Figure, show
from bench.servers import ROOT, TOKEN, call, ours
from tests.support.browser import browsing
from tests.support.made import plant_document

PLANTS = VERSIONS = EPISODES = 10**5
LOOKS, OPENED = 40, 10
SLOWEST_MS, INTERACTIVE_S, LIGHTEST = 100.0, 1.0, 500_000
AT, BY = "2026-01-01T00:00:00.000000Z", "bench"


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        figures = _many(Path(name) / "many") + _diagnosis(Path(name) / "one")
    show("Pages", figures)


def _many(data: Path) -> list[Figure]:
    with ours(data) as (port, _, _):
        call(port, "POST", "/v1/plants", plant_document("p"))
    fill(data / "trueup.sqlite", VERSIONS)
    _add_plants(data / "trueup.sqlite")
    _add_episodes(data / "trueup.sqlite")
    figures = []
    with ours(data) as (port, _, _):
        for what, path in {
            "all plants, first page": "/",
            "all plants, a page in the middle": "/?after=many-050000",
            "a search that finds few": "/?q=99123",
            "a search that finds none": "/?q=no-such-name",
            "plants of a tag that few have": "/?tag=site-7",
            "plants whose alarm is open": "/?alarm=open",
            "a plant of 10^5 versions and episodes": "/plants/p",
            "a minute of its timeline": f"/plants/p?since={AT}&until=2026-01-01T00:01:00Z",
            "its versions, the newest": "/plants/p/versions",
            "its versions by name": "/plants/p/versions?sort=name",
            "its episodes, the newest": "/plants/p/episodes",
            "its episodes by duration": "/plants/p/episodes?sort=-duration",
            "its episodes whose name contains a text": "/plants/p/episodes?q=run-0512",
            "the log": "/audit",
        }.items():
            seconds = []
            for _ in range(LOOKS):
                request = urllib.request.Request(
                    f"http://127.0.0.1:{port}{path}", headers={"Authorization": f"Bearer {TOKEN}"}
                )
                began = time.perf_counter()
                with urllib.request.urlopen(request) as answer:
                    answer.read()
                seconds.append(time.perf_counter() - began)
            ms = 1e3 * np.quantile(seconds[1:], [0.5, 0.99])
            figures.append(
                Figure(
                    f"{what}, p50 / p99",
                    f"{ms[0]:.0f} / {ms[1]:.0f} ms",
                    f"< {SLOWEST_MS:g} ms",
                    bool(ms[0] < SLOWEST_MS),
                )
            )
    return figures


def _add_plants(path: Path) -> None:
    """Plants that each serve one version, every tenth watched, every seventh judged and alarmed."""
    with sqlite3.connect(path) as to:
        row = to.execute("select digest, document from plants").fetchone()
        artifact = to.execute("select digest, kind, manifest from artifacts limit 1").fetchone()
        names = [f"many-{i:06d}" for i in range(PLANTS)]
        to.executemany(
            "insert into labels values (?, 'plant', ?, ?, ?, null, ?, ?)",
            [(n, n, f"bench {i}", f'["site-{i % 1000}"]', AT, BY) for i, n in enumerate(names)],
        )
        to.executemany(
            "insert into plants values (?, ?, ?, ?, ?, null)", [(n, *row, AT, BY) for n in names]
        )
        to.executemany(
            "insert into artifacts values (?, 1, ?, ?, ?, null, null, ?, ?)",
            [(n, *artifact, AT, BY) for n in names],
        )
        to.executemany(
            "insert into moves values (?, 1, 'registered', ?, 1, null, null, ?, ?)",
            [(n, artifact[0], AT, BY) for n in names],
        )
        to.executemany("insert into serving values (?, 1)", [(n,) for n in names])
        seen = json.dumps(
            {"channels": {"q": {"mean": 0.1, "rms": 1.1}, "v": {"mean": 0.0, "rms": 0.9}}}
        )
        for n in names[::10]:
            to.execute(
                "insert into monitors values (?, ?, ?, '{}', null, ?, ?)",
                (n, "0" * 64, artifact[0], AT, BY),
            )
            to.execute("insert into watching values (?, ?, ?, 40, '{}')", (n, "0" * 64, AT))
            to.executemany(
                "insert into watches values (?, ?, ?, ?, ?, ?)",
                [(n, "0" * 64, i, f"{i:064d}", seen, AT) for i in range(1, 41)],
            )
        for i, n in enumerate(names[::7]):
            to.execute("insert into gates values (?, ?, '{}', ?, ?)", (n, "1" * 64, AT, BY))
            decision = (
                f"{i:064d}",
                n,
                "1" * 64,
                artifact[0],
                artifact[0],
                1,
                True,
                "{}",
                None,
                AT,
                BY,
            )
            to.execute(f"insert into decisions values ({', '.join('?' * len(decision))})", decision)
            alarm = (f"{i:032d}", n, artifact[0], "2" * 64, AT)
            to.execute(
                (
                    "insert into alarms (id, plant, artifact, episode, document, raised_at) "
                    "values (?, ?, ?, ?, '{}', ?)"
                ),
                alarm,
            )
        to.execute("analyze")


def _add_episodes(path: Path) -> None:
    """Episodes of one plant, each named and with a summary as long as a real one's."""
    ranges = {f"channel_{i}": {"low": -1.234, "high": 5.678, "unit": "rad"} for i in range(8)}
    summary = json.dumps({"samples": 5000, "duration_s": 10.0, "conditions": {}, "ranges": ranges})
    columns = "plant, digest, size_bytes, role, start_ns, end_ns, summary, created_at, created_by"
    with sqlite3.connect(path) as to:
        to.executemany(
            f"insert into episodes ({columns}) values ('p', ?, 100000, ?, ?, ?, ?, ?, ?)",
            [
                (
                    f"{i:064x}",
                    "adaptation" if i % 3 else "validation",
                    i * 10**10,
                    i * 10**10 + 10**9 * (i % 977),
                    summary,
                    f"2026-01-01T{i // 3600 % 24:02d}:{i // 60 % 60:02d}:{i % 60:02d}.{i:06d}Z",
                    BY,
                )
                for i in range(EPISODES)
            ],
        )
        to.executemany(
            "insert into labels values ('p', 'episode', ?, ?, '[]', null, ?, ?)",
            [(f"{i:064x}", f"run-{i:06d}.mcap", AT, BY) for i in range(EPISODES)],
        )
        to.execute("analyze")


def _diagnosis(data: Path) -> list[Figure]:
    """A diagnosis of the real recordings, opened by a browser that has seen nothing of it yet."""
    with ours(data, worker=True) as (port, _, _):
        url, case = f"http://127.0.0.1:{port}", str(ROOT / "examples" / "emps")
        for command in (
            ["plant", "register", case],
            ["upload", "emps", case],
            ["diagnosis", "emps"],
        ):
            subprocess.run(
                [sys.executable, "-m", "trueup_cli.main", *command, "--url", url],
                cwd=ROOT,
                check=True,
                capture_output=True,
            )
        job = next(
            j["id"]
            for j in call(port, "GET", "/v1/plants/emps/jobs")["items"]
            if j["kind"] == "diagnose"
        )
        seconds, weight = [], 0
        with browsing() as browser:
            for _ in range(OPENED):
                context = browser.new_context()
                page = context.new_page()
                page.goto(f"{url}/sign-in")
                page.get_by_label("Token").fill(TOKEN)
                page.keyboard.press("Enter")
                page.wait_for_url(f"{url}/")
                loaded = []
                page.on("response", lambda response, into=loaded: into.append(response))
                page.goto(f"{url}/plants/emps/diagnoses/{job}")
                page.wait_for_selector("#recordings canvas")
                seconds.append(page.evaluate("performance.now()") / 1e3)
                page.wait_for_load_state("networkidle")
                # the stream of what others do has no end
                weight = sum(len(r.body()) for r in loaded if "/live" not in r.url)
                context.close()
    middle, worst = float(np.median(seconds)), max(seconds)
    drawn = "a diagnosis, from asking to drawn and movable, p50 / worst"
    return [
        Figure(
            drawn, f"{middle:.2f} / {worst:.2f} s", f"< {INTERACTIVE_S:g} s", worst < INTERACTIVE_S
        ),
        Figure(
            "all that it loads, uncompressed",
            f"{weight / 1e3:.0f} kB",
            f"< {LIGHTEST / 1e3:.0f} kB",
            weight < LIGHTEST,
        ),
    ]
