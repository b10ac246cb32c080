"""Conduct a blind trial: draw, commit, diagnose, open.

specification  what is hidden, drawn by a secret that the caller keeps until the end
recordings     case folders on disk, searched for what is hidden: nothing in them may spell it
commitment     published before the first diagnosis
diagnosis      by whoever is given a folder and nothing else
opening        labels, salts and the secret, so that anybody can compare them with the commitments,
               or draw it all again
"""

from __future__ import annotations

import os
from base64 import b64decode
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np
from numpy.typing import NDArray

import trueup
from trueup.artifact.artifact import Artifact, unpack
from trueup.blindtrial.commitment import commitment, require_no_leak, salt_of
from trueup.blindtrial.recording import case_files, conditions_of, held_out_episodes
from trueup.blindtrial.scoring import (
    Answer,
    answer_words,
    score_answer,
    score_intervals,
    summarise,
)
from trueup.blindtrial.specification import (
    absorbed_effects,
    draw_specifications,
    draw_trial,
    label_of,
)
from trueup.blindtrial.trial_plant import TrialPlant, trial_plant
from trueup.canonical import Json, digest_of_bytes
from trueup.diagnose.measure import closed_on
from trueup.episode.episode import Episode
from trueup.model.plant import Plant
from trueup.simulate.trial import Bench

SCHEMA = "trueup.blindtrial/1"
DRAWING = 0.2  # share of the trial's time

# Given a case folder, its `report`, `manifest` and `arrays` (base64), or a `problem`; and `seconds`
Diagnose = Callable[[Path], Mapping[str, Any]]
# Given every case folder, their responses in order, as they come
DiagnoseAll = Callable[[Sequence[Path]], Iterable[Mapping[str, Any]]]
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class CommittedTrial:
    """One trial before it is opened; its folder is all that a diagnosing process is given."""

    folder: Path
    label: Mapping[str, Json]
    salt: str
    commitment: str
    held_out: Sequence[Episode]
    sigma: NDArray[np.float64]


@dataclass(frozen=True)
class Secret:
    """What a trial is drawn by, and whether it draws an opened one again."""

    value: bytes
    is_opened: bool = False


def conduct(
    plant: Plant,
    episodes: Sequence[Episode],
    count: int,
    secret: Secret,
    commit: Callable[[list[str]], None],
    progress: Progress,
    diagnose_all: DiagnoseAll,
    keep: Path,
) -> dict[str, Any]:
    """The report of `count` trials like a user's plant and episodes.

    `commit` is called with the commitments before the first diagnosis. Cases are written into the
    folder `keep` and diagnosed by `diagnose_all`. Raises NotIdentifiable, LabelLeaked.
    """
    source = trial_plant(plant)
    bench = source.bench(episodes)
    committed = []
    for trial in _draw(source, bench, conditions_of(episodes), count, secret.value, keep):
        committed.append(trial)
        progress("drawing machines and recording them", DRAWING * len(committed) / count)
    commit([c.commitment for c in committed])
    responses = []
    for response in diagnose_all([c.folder for c in committed]):
        responses.append(response)
        progress("diagnosing", DRAWING + (1.0 - DRAWING) * len(responses) / count)
    answers = [Answer(r.get("report"), r.get("problem"), float(r["seconds"])) for r in responses]
    rows = [
        _row(i, *parts) for i, parts in enumerate(zip(committed, responses, answers, strict=True))
    ]
    return {
        "schema": SCHEMA,
        "plant": plant.name,
        "trials": count,
        **summarise(rows, answers),
        "rows": list(rows),
        "bench": _bench_document(source, bench, episodes),
        "opening": {"secret": secret.value.hex(), "redrawn": secret.is_opened},
        "version": trueup.__version__,
    }


def _bench_document(
    source: TrialPlant, bench: Bench, episodes: Sequence[Episode]
) -> dict[str, Json]:
    """How the machines were simulated, for the report."""
    return {
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
        "robot": bench.robot,
        "left_out": absorbed_effects(source),
    }


def _draw(
    source: TrialPlant,
    bench: Bench,
    conditions: Mapping[str, str],
    count: int,
    secret: bytes,
    where: Path,
) -> Iterator[CommittedTrial]:
    """Draw machines, record them into folders under `where`, and commit their labels. Raises
    LabelLeaked."""
    plant = source.plant
    rng = np.random.default_rng(int.from_bytes(bytes.fromhex(digest_of_bytes(secret + b"/lots"))))
    own: Json = [dict(plant.document), dict(conditions)]
    for i, specification in enumerate(draw_specifications(source, count, rng)):
        trial = draw_trial(source, bench, specification, rng)
        label, salt = label_of(plant, specification, trial), salt_of(secret, i)
        files = case_files(plant, trial, conditions)
        require_no_leak(files, label, salt, own)
        folder = where / f"{i:04d}"
        folder.mkdir(parents=True)
        for name, data in files.items():
            (folder / name).write_bytes(data)
            os.utime(folder / name, (0, 0))  # the time that drawing took might reveal the machine
        os.utime(folder, (0, 0))
        yield CommittedTrial(
            folder,
            label,
            salt,
            commitment(label, salt),
            held_out_episodes(plant, trial),
            trial.sigma,
        )


def side_by_side(diagnosers: Sequence[Diagnose]) -> DiagnoseAll:
    """Diagnosis of all cases by some diagnosers, each of which takes one case at a time."""

    def diagnose_all(folders: Sequence[Path]) -> Iterator[Mapping[str, Any]]:
        free: SimpleQueue[Diagnose] = SimpleQueue()
        for diagnoser in diagnosers:
            free.put(diagnoser)

        def ask(folder: Path) -> Mapping[str, Any]:
            diagnoser = free.get()
            try:
                return diagnoser(folder)
            finally:
                free.put(diagnoser)

        with ThreadPoolExecutor(len(diagnosers)) as pool:
            yield from pool.map(ask, folders)

    return diagnose_all


def _row(
    index: int, committed: CommittedTrial, response: Mapping[str, Any], answer: Answer
) -> dict[str, Json]:
    """One opened trial, as a row of the report."""
    closed = None
    if "manifest" in response:
        model = Artifact(response["manifest"].encode(), b64decode(response["arrays"]))
        closed = closed_on(unpack(model), committed.held_out, committed.sigma)
    report = answer.report
    return {
        "index": index,
        "label": committed.label,
        "salt": committed.salt,
        "commitment": committed.commitment,
        "verdict": answer.verdict,
        "problem": answer.problem,
        "answer": answer_words(answer),
        "indistinguishable": report["indistinguishable"] if report else [],
        "closed": closed,
        "unexplained": report["evidence"]["unexplained"] if report else None,
        "intervals": score_intervals(committed.label, answer),
        "reported_closed": report["gap"]["closed"] if report else None,
        "seconds": answer.seconds,
        **score_answer(committed.label, answer),
    }
