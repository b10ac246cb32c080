"""`trueup doctor CASE`: what is wrong with the recordings of a case, and the case once mended."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from trueup.diagnose.case import read_case, read_recording, recordings_of
from trueup.doctor.answers import Loop, loop
from trueup.doctor.examine import examine
from trueup.doctor.finding import Finding, documents, files_of
from trueup.doctor.log import Log
from trueup.doctor.mends import Shifted, without_masked
from trueup.episode.episode import Episode
from trueup.episode.writer import write_episode
from trueup.errors import NotAnEpisode
from trueup.model.plant import Plant
from trueup_cli.show import as_json, progress, say, table

SCHEMA = "trueup.doctor/1"
MENDS_FILE = "mends.json"


@dataclass(frozen=True)
class Examined:
    """A case with what was found wrong with its recordings."""

    folder: Path
    plant: Plant
    episodes: Mapping[Path, Episode]
    findings: Sequence[Finding]
    loops: Sequence[tuple[str | None, Loop]]

    def document(self, mended: Path | None) -> dict[str, Any]:
        """The examination as JSON."""
        return {
            "schema": SCHEMA,
            "plant": self.plant.name,
            "findings": documents(self.findings),
            "loops": [{"joint": joint, **asdict(closed)} for joint, closed in self.loops],
            "episodes": [
                {"file": file.name, "sha256": e.digest} for file, e in self.episodes.items()
            ],
            "mended": str(mended) if mended else None,
        }


def examined(folder: Path) -> Examined:
    """Examines a case folder. Raises BadPlant, BadEpisode."""
    with progress("doctor") as bar:
        bar(0.0, "reading the episodes")
        plant, episodes = read_case(folder)
        bar(0.3, "looking for faults")
        findings = examine(plant, episodes)
        log = Log(plant, episodes)
        loops = [
            (plant.joints[j], closed)
            for j in range(len(plant.joints))
            if (closed := loop(log, j)) is not None
        ]
        bar(1.0, "done")
    by_file = dict(zip(recordings_of(folder), episodes, strict=True))
    return Examined(folder, plant, by_file, findings, loops)


def mend(case: Examined, out: Path) -> list[Path]:
    """Writes the case with every mend applied, and what was done to which recording. The originals
    stay as they are. Raises NotAnEpisode where the folder holds recordings."""
    if out.exists() and any(out.glob("*.mcap")):
        raise NotAnEpisode(
            f"{out} holds recordings already", hint="Name a folder without any.", rule="folder"
        )
    out.mkdir(parents=True, exist_ok=True)
    for other in case.folder.iterdir():
        if other.is_dir():
            shutil.copytree(other, out / other.name, dirs_exist_ok=True)
        elif other.suffix != ".mcap":
            shutil.copy2(other, out / other.name)
    written, records = [], []
    for file, episode in case.episodes.items():
        mine = [f for f in case.findings if episode.digest in f.episodes and (f.mends or f.applied)]
        pieces = _mended(case, file, episode)
        for number, piece in enumerate(pieces, 1):
            to = out / (file.name if len(pieces) == 1 else f"{file.stem}-{number}.mcap")
            _write(case.plant, piece, mine, to)
            written.append(to)
        records.append(
            {
                "file": file.name,
                "sha256": episode.digest,
                "written": [p.name for p in written[-len(pieces) :]] if pieces else [],
                "mends": [{"finding": str(f.fault), "mend": f.advice} for f in mine],
            }
        )
    (out / MENDS_FILE).write_text(json.dumps({"schema": SCHEMA, "episodes": records}, indent=1))
    return written


def _mended(case: Examined, file: Path, episode: Episode) -> list[Episode]:
    """What a recording becomes; where its stamps are late it is read again, for a command between
    two samples has to be taken from the recording."""
    mends = [m for f in case.findings for m in f.mends if episode.digest in m.episodes]
    late = [m.late_s for m in mends if isinstance(m, Shifted)]
    pieces = [read_recording(file, case.plant, late[0]) if late else episode]
    for step in mends:
        if not isinstance(step, Shifted):
            pieces = step.applied_to(pieces)
    return [without_masked(p) for p in pieces]


def _write(plant: Plant, piece: Episode, findings: Sequence[Finding], to: Path) -> None:
    """Writes an episode, with where it came from and what was done to it among its conditions."""
    conditions = dict(piece.conditions)
    if findings:
        conditions["mended_from"] = piece.recording
        conditions["mends"] = ", ".join(dict.fromkeys(str(f.fault) for f in findings))
    stamps = piece.start_ns + np.rint(1e9 * (piece.begins_s + piece.t_s)).astype(np.int64)
    with to.open("wb") as stream:
        write_episode(
            stream,
            stamps_ns=stamps,
            observations=piece.observations,
            commands=piece.commands,
            layout=plant.layout,
            role=piece.role,
            conditions=conditions,
            applied=piece.applied,
            effort=piece.effort,
        )


def show(case: Examined, mended: Path | None, *, json_: bool) -> None:
    """Prints what was found."""
    if json_:
        as_json(case.document(mended))
        return
    names = {e.digest: file.name for file, e in case.episodes.items()}
    rows = [
        (
            str(f.fault),
            " ".join(filter(None, (f.channel, f"at {f.joint}" if f.joint else None))) or "all",
            affected(f, names),
            _span(f),
            f"{100 * f.confidence:.0f} %",
            f.evidence,
            f.advice,
        )
        for f in case.findings
    ]
    if rows:
        table(
            f"{case.plant.name}: what is wrong with the log",
            ["finding", "where", "recordings", "from to [s]", "sure", "evidence", "mend"],
            rows,
        )
    else:
        say("Nothing is wrong with the {} recordings of {}.", len(case.episodes), case.plant.name)
    for joint, closed in case.loops:
        if closed.kind != "open":
            say(
                "The command {} is that of a {} loop: gains {} and {}.",
                f"at {joint}" if joint else "",
                closed.kind,
                f"{closed.position:.4g}",
                f"{closed.velocity:.4g}",
            )
    if mended:
        say("Mended: {}", mended)
    elif any(f.mends for f in case.findings):
        say("Mend it: trueup doctor {} --mend OUT", case.folder)


def affected(finding: Finding, names: Mapping[str, str]) -> str:
    """The recordings of a finding by their names; of several how many, where all have it."""
    every = len(finding.episodes) == len(names) and len(names) > 1
    return f"all {len(names)}" if every else files_of(finding, names)


def _span(finding: Finding) -> str:
    times = [f"{t:.4g}" for t in (finding.from_s, finding.to_s) if t is not None]
    return " ".join(times)
