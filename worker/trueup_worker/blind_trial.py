"""Conduct a blind trial: draw faults, commit to them, have them diagnosed in isolation, open them.

lots        the hidden faults, drawn with a secret that exists in this process alone
recordings  case folders on disk, which are checked not to spell their labels
commitment  published before the first diagnosis
rooms       isolated processes that receive a folder and nothing else
opening     labels, salts and the secret: anybody can check them against the commitments, or draw
            the trial again
"""

from __future__ import annotations

import os
import tempfile
from base64 import b64decode
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np
from numpy.typing import NDArray

import trueup
from trueup.artifact.artifact import Artifact, unpack
from trueup.blindtrial.bench import bench_of
from trueup.blindtrial.lot import draw_lots, label_of, machine_of, spelled_out
from trueup.blindtrial.recording import case_files, conditions_of, tests
from trueup.blindtrial.seal import commitment, require_silent, salt_of
from trueup.blindtrial.tally import Answer, answer_words, intervals, judge, tally
from trueup.canonical import Json, digest_of_bytes
from trueup.diagnose.measure import closed_on
from trueup.episode.episode import Episode
from trueup.errors import TrueupError
from trueup.model.plant import Plant
from trueup.simulate.robot_trial import RobotBench
from trueup.simulate.trial import Bench
from trueup_worker.blind_room import NO_ANSWER, Room

SCHEMA = "trueup.blindtrial/1"
SECRET_BYTES = 32
DRAWING = 0.2  # share of the trial's time

Diagnose = Callable[[Path], Mapping[str, Any]]
Progress = Callable[[str, float], None]


class NoRoom(TrueupError):
    """No isolated process could be started to diagnose in."""

    code = "no-room"
    hint = (
        "Install trueup into the environment that runs it: the processes are started "
        "without any other path."
    )


@dataclass(frozen=True)
class Sealed:
    """One trial before it is opened. A room receives its folder alone."""

    folder: Path
    label: Mapping[str, Json]
    salt: str
    commitment: str
    tests: Sequence[Episode]
    sigma: NDArray[np.float64]


def conduct(
    plant: Plant,
    episodes: Sequence[Episode],
    count: int,
    secret: bytes | None,
    commit: Callable[[list[str]], None],
    progress: Progress,
    rooms: Sequence[Diagnose] | None = None,
    keep: Path | None = None,
) -> dict[str, Any]:
    """Returns the report of `count` trials modelled on a user's plant and episodes.

    With the `secret` of an opened trial it draws that trial again; without one it draws a new
    secret. `commit` is called with the commitments before the first diagnosis. `keep` is a folder
    for the cases, made when the first is written; without one they are removed. Raises
    NotIdentifiable, LabelLeaked, NoRoom.
    """
    bench, hidden = bench_of(plant, episodes), secret or os.urandom(SECRET_BYTES)
    with tempfile.TemporaryDirectory(prefix="blind-") as temporary:
        sealed = []
        for trial in _drawn(
            plant, bench, conditions_of(episodes), count, hidden, keep or Path(temporary)
        ):
            sealed.append(trial)
            progress("drawing machines and recording them", DRAWING * len(sealed) / count)
        commit([s.commitment for s in sealed])
        answers = []
        for answer in _diagnosed([s.folder for s in sealed], rooms):
            answers.append(answer)
            progress("diagnosing", DRAWING + (1.0 - DRAWING) * len(answers) / count)
    if all(str(a.get("problem", "")).startswith(NO_ANSWER) for a in answers):
        raise NoRoom("no diagnosing process ever answered: " + str(answers[0]["problem"]))
    judged = [Answer(a.get("report"), a.get("problem"), float(a["seconds"])) for a in answers]
    rows = [
        _row(i, plant, *parts) for i, parts in enumerate(zip(sealed, answers, judged, strict=True))
    ]
    return {
        "schema": SCHEMA,
        "plant": plant.name,
        "trials": count,
        **tally(rows, judged),
        "rows": list(rows),
        "bench": {
            "episodes": [
                {"sha256": e.digest, "role": str(e.role)}
                for e in sorted(episodes, key=lambda e: e.digest)
            ],
            "period_s": bench.timestep_s,
            "fine_step_s": bench.timestep_s / bench.parts,
            "sigma": [float(x) for x in bench.sigma] if bench.sigma is not None else [],
            "feedback": {k: np.ravel(v).tolist() for k, v in asdict(bench.feedback).items()}
            if bench.feedback
            else None,
            "robot": isinstance(bench, RobotBench),
            "left_out": spelled_out(plant),
        },
        "opening": {"secret": hidden.hex(), "redrawn": secret is not None},
        "version": trueup.__version__,
    }


def _drawn(
    plant: Plant,
    bench: Bench | RobotBench,
    conditions: Mapping[str, str],
    count: int,
    secret: bytes,
    where: Path,
) -> Iterator[Sealed]:
    rng = np.random.default_rng(int.from_bytes(bytes.fromhex(digest_of_bytes(secret + b"/lots"))))
    own: Json = [dict(plant.document), dict(conditions)]
    for i, lot in enumerate(draw_lots(plant, count, rng)):
        trial = machine_of(plant, bench, lot, rng)
        label, salt = label_of(plant, lot, trial), salt_of(secret, i)
        files = case_files(plant, trial, conditions)
        require_silent(files, label, salt, own)
        folder = where / f"{i:04d}"
        folder.mkdir(parents=True)
        for name, data in files.items():
            (folder / name).write_bytes(data)
            os.utime(folder / name, (0, 0))  # times could tell how long a machine took to draw
        os.utime(folder, (0, 0))
        yield Sealed(folder, label, salt, commitment(label, salt), tests(plant, trial), trial.sigma)


def _diagnosed(
    folders: Sequence[Path], rooms: Sequence[Diagnose] | None
) -> Iterator[Mapping[str, Any]]:
    """Yields every folder's answer, in order. Without `rooms` each core gets one."""
    with ExitStack() as stack:
        rooms = rooms or [stack.enter_context(Room(core)) for core in _cores()]
        free: SimpleQueue[Diagnose] = SimpleQueue()
        for room in rooms:
            free.put(room)

        def ask(folder: Path) -> Mapping[str, Any]:
            room = free.get()
            try:
                return room(folder)
            finally:
                free.put(room)

        with ThreadPoolExecutor(len(rooms)) as pool:
            yield from pool.map(ask, folders)


def _cores() -> list[int]:
    return (
        sorted(os.sched_getaffinity(0))
        if hasattr(os, "sched_getaffinity")
        else list(range(os.cpu_count() or 1))
    )


def _row(
    index: int, plant: Plant, sealed: Sealed, answer: Mapping[str, Any], judged: Answer
) -> dict[str, Json]:
    closed = None
    if "manifest" in answer:
        model = Artifact(answer["manifest"].encode(), b64decode(answer["arrays"]))
        closed = closed_on(unpack(model), sealed.tests, sealed.sigma)
    return {
        "index": index,
        "label": sealed.label,
        "salt": sealed.salt,
        "commitment": sealed.commitment,
        "verdict": judged.verdict,
        "problem": judged.problem,
        "answer": answer_words(judged),
        "indistinguishable": judged.report["indistinguishable"] if judged.report else [],
        "closed": closed,
        "unexplained": judged.report["evidence"]["unexplained"] if judged.report else None,
        "intervals": intervals(sealed.label, judged),
        "reported_closed": judged.report["gap"]["closed"] if judged.report else None,
        "seconds": judged.seconds,
        **judge(sealed.label, judged),
    }
