"""`trueup replay`: recompute decisions from the bytes that they were made from.

A recomputation that agreed is kept by the decision's digest and the code that made it: everything
else that it depends on is named by digests in the decision. Disagreements are never kept.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from datetime import UTC, datetime
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import quote

from trueup.canonical import is_digest
from trueup.cores import cores
from trueup.errors import NoSuchDigest, TrueupError
from trueup_cli.digests import resolve_digest
from trueup_cli.exits import DISAGREES
from trueup_cli.options import DEFAULT_URL, Json, Url, connect, connect_witnessed
from trueup_cli.show import as_json, err, progress, say, table
from trueup_client import Client
from trueup_client.problem import ClientError
from trueup_client.records import Decision

WARM = 2  # decisions: the first one also loads the libraries and compiled kernels
STARTING_S = 3.0  # what other processes take to start and to load the same, and as much again


class Agreed:
    """Digests of decisions whose recomputation agreed, with the code of this installation, in a
    file. A file that cannot be read or written keeps nothing."""

    def __init__(self, file: Path) -> None:
        self._file, self._code = file, _code()
        self._digests: set[str] = set()
        with suppress(OSError, ValueError, KeyError, TypeError):
            kept = json.loads(file.read_text())
            if kept["code"] == self._code:
                self._digests = set(kept["decisions"])

    def __contains__(self, decision: str) -> bool:
        return decision in self._digests

    def add(self, decision: str) -> None:
        """Keep a decision that agreed."""
        self._digests.add(decision)
        content = json.dumps({"code": self._code, "decisions": sorted(self._digests)})
        with suppress(OSError):
            self._file.parent.mkdir(parents=True, exist_ok=True)
            partial_file = self._file.with_suffix(".part")
            partial_file.write_text(content)
            partial_file.replace(self._file)


def agreed_file(url: str) -> Path:
    """Returns the file of this user's agreed recomputations of a service's decisions."""
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(state) / "trueup" / "replayed" / f"{quote(url, safe='')}.json"


def _code() -> str:
    """The version and the bytes of the code that recomputes."""
    from trueup.code_identity import code_identity

    return str(code_identity()["sha256"])


def replayed(url: str, decisions: Sequence[str]) -> Iterator[tuple[str, list[str]]]:
    """Yields each decision as it is recomputed, with how it differs from the recorded one.

    The first ones are recomputed here; once they say that the rest takes longer than other
    processes take to start, those do several at once.
    """
    rest = decisions
    while rest:
        began = time.perf_counter()
        differences = replay_differences(url, rest[0])
        took_s = time.perf_counter() - began
        yield rest[0], differences
        rest = rest[1:]
        warm = len(decisions) - len(rest) >= WARM
        if warm and took_s * len(rest) > STARTING_S and min(cores(), len(rest)) > 1:
            break
    if rest:
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(min(cores(), len(rest)), mp_context=context) as pool:
            yield from zip(rest, pool.map(partial(replay_differences, url), rest), strict=True)


def made_since(client: Client, decisions: Sequence[str], since: str | None) -> Sequence[str]:
    """Returns those decisions that were made since a time in UTC; all where it is None. Raises
    NotATime."""
    if since is None:
        return decisions
    try:
        at = datetime.fromisoformat(since)
    except ValueError:
        raise NotATime(f"{since!r} is no time") from None
    begin = (at if at.tzinfo else at.replace(tzinfo=UTC)).astimezone(UTC)
    return [
        d
        for d in decisions
        if datetime.fromisoformat(client.find_decision(d)["created_at"]) >= begin
    ]


class NotATime(TrueupError):
    """The text is no time."""

    code = "not-a-time"
    hint = "Write it as 2026-11-01 or 2026-11-01T12:00, in UTC."


def replay_differences(url: str, decision: str) -> list[str]:
    """Returns how a decision differs from the one that its bytes give."""
    from trueup.gate.recompute import differences

    with connect(url) as client:
        record = client.find_decision(decision)
        recorded = record["document"]
        try:
            with tempfile.TemporaryDirectory() as folder:
                recomputed = recompute(
                    client, record["plant"], recorded, Path(folder), lambda *_: None
                )
                return differences(recorded, recomputed)
        except (TrueupError, ClientError) as error:
            return [f"cannot be recomputed: {error}"]


def _whole(client: Client, prefix: str) -> str:
    """Returns a decision's digest by its first digits, among those of every plant that is seen.
    Raises NoSuchDigest."""
    if is_digest(prefix):
        return prefix
    if not prefix:
        raise NoSuchDigest("no decision is named", hint="`trueup decisions PLANT` lists them.")
    decisions = chain.from_iterable(client.decisions(str(p["name"])) for p in client.plants())
    return resolve_digest(prefix, decisions, "decision", "trueup decisions PLANT")


def disagree(what: str) -> NoReturn:
    """Says what does not agree, and exits with the code for that."""
    say("[bold red]disagrees[/] {}", what, to=err)
    sys.exit(DISAGREES)


def _consistent_document(record: Decision) -> dict[str, Any] | None:
    """Returns a decision's document; None if its digest or its columns do not match it."""
    from trueup.canonical import digest_of

    document: dict[str, Any] = record["document"]
    same = all(
        record[name] == document[name]
        for name in ("gate", "candidate", "incumbent", "generation", "accepted")
    )
    return document if same and digest_of(document) == record["digest"] else None


def replay(decision: str, *, url: Url = DEFAULT_URL, as_json_: Json = False) -> None:
    """Recompute a decision here from its gate, artifacts and episodes, and check that it agrees.

    The exit code is 4 if it does not.

    Parameters
    ----------
    decision
        digest of the decision, or its first digits
    """
    from trueup.gate.recompute import differences

    client = connect_witnessed(url)
    decision = _whole(client, decision)
    record = client.find_decision(decision)
    recorded = _consistent_document(record)
    if recorded is None or record["digest"] != decision:
        disagree(
            "the decision's document is not the one that its digest names, or its columns "
            "say something else"
        )
    try:
        with progress("replay") as bar, tempfile.TemporaryDirectory() as folder:
            recomputed = recompute(client, record["plant"], recorded, Path(folder), bar)
    except TrueupError as error:
        disagree(f"{error.code}: {error.message}")
    wrong = differences(recorded, recomputed)
    if as_json_:
        as_json(
            {
                "decision": decision,
                "agrees": not wrong,
                "differences": wrong,
                "recomputed": recomputed,
            }
        )
    else:
        _show(recorded, recomputed, wrong)
    if wrong:
        sys.exit(DISAGREES)


def recompute(
    client: Client, plant: str, recorded: dict[str, Any], folder: Path, progress: Any
) -> dict[str, Any]:
    """Recomputes a decision's document from verified bytes, which it fetches into `folder`."""
    from trueup.artifact.model import load
    from trueup.canonical import digest_of
    from trueup.episode.mcap import read_episode
    from trueup.gate import recompute as recomputation

    predictors = {
        name: load(client.fetch(plant, digest, folder / name), digest).predictor
        for name, digest in recomputation.models(recorded).items()
    }
    layout = predictors["candidate"].plant.layout
    episodes = []
    for count, digest in enumerate(recorded["episodes"]):
        path = folder / f"{digest}.mcap"
        client.download_episode(plant, digest, path)
        episodes.append(read_episode(path.read_bytes(), layout))
        progress(0.5 * (count + 1) / len(recorded["episodes"]), "fetching episodes")
    return recomputation.recompute(
        recorded,
        client.gate(plant, recorded["gate"])["document"],
        predictors,
        episodes,
        digest_of(client.plant(plant)["document"]),
        lambda share: progress(0.5 + 0.5 * share, "scoring"),
    )


def _show(recorded: dict[str, Any], recomputed: dict[str, Any], differences: list[str]) -> None:
    from trueup.gate.line import disclosure

    pairs = zip(recorded["verdicts"], recomputed["verdicts"], strict=True)
    table(
        "",
        ["rule", "recorded", "recomputed", "threshold", "passed"],
        [(a["rule"], a["value"], b["value"], b["threshold"], b["passed"]) for a, b in pairs],
    )
    say(
        "[bold red]disagrees[/]"
        if differences
        else "[bold green]agrees[/]: every figure and the verdict"
    )
    for difference in differences:
        say("{}", difference)
    say(
        "{}",
        disclosure(recorded)
        or (
            "It does not say what was known when its gate was declared: trueup audit "
            "verify works it out."
        ),
    )
