"""What a robot runs: which model to use, verified, from disk; the service is asked beside, and may
be away for ever.

    robot = Robot("http://registry:8321", "cell-7", "/var/lib/trueup", key="trueup-…+…+…")
    robot.start()                     # looks for a newer answer in a thread of its own
    while True:
        model = robot.current()       # at once, from what is on disk; None before the first answer

An answer counts only if the log's key signed it, for this plant, and its generation is not behind
one that was seen. Its artifact is fetched and verified before it takes the place of the last good
one. Each answer brings the log's checkpoint: the robot is a witness of it.
"""

from __future__ import annotations

import json
import os
import shutil
import threading
import uuid
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from trueup_client.client import Client, is_whole, sync_folder
from trueup_client.problem import LogForked, NotSigned
from trueup_client.proof import Key
from trueup_client.records import Envelope
from trueup_client.witness import Witness

ENVELOPE_TYPE, SCHEMA = "application/vnd.trueup.serving+json", "trueup.serving/1"
LOOK_S = 30.0


def _now() -> datetime:
    return datetime.now(UTC)


@dataclass(frozen=True, slots=True)
class Answer:
    """What a plant's robot is to use.

    `expires_at` is when the answer stops being current; `fallback` is the artifact that served
    before.
    """

    plant: str
    artifact: str
    version: int
    generation: int
    decision: str | None
    fallback: str | None
    issued_at: str
    expires_at: str

    def is_current(self, now: datetime) -> bool:
        """Whether the service still stands by it."""
        return now < datetime.fromisoformat(self.expires_at)


@dataclass(frozen=True, slots=True)
class Model:
    """A verified model on disk: manifest.json and arrays.safetensors are in `folder`."""

    folder: Path
    answer: Answer


class Robot:
    """Keeps the last good model of a plant in a folder, with the one before it as the way back.

    `key` is the log's public key (`trueup key`); without it the first one seen is believed from
    then on.
    """

    def __init__(
        self,
        url: str,
        plant: str,
        folder: str | os.PathLike[str],
        key: str | None = None,
        *,
        token: str | None = None,
        timeout_s: float = 30.0,
        clock: Callable[[], datetime] = _now,
    ) -> None:
        self._folder = Path(folder)
        self._folder.mkdir(parents=True, exist_ok=True)
        self._address, self._plant, self._clock = (url, token, timeout_s), plant, clock
        self._witness = Witness(self._folder / "witness.json", key)
        self._stop = threading.Event()
        self._model = self._kept()
        self._highest = self._seen()
        self.problem: Exception | None = (
            None  # why the last look changed nothing, None where it went well
        )

    def current(self) -> Model | None:
        """The last good model; never asks the service, never waits."""
        return self._model

    def is_current(self) -> bool:
        """Whether the service said so lately enough; a robot whose answer has expired keeps its
        model, and should say so."""
        return self._model is not None and self._model.answer.is_current(self._clock())

    def fallback(self) -> Path | None:
        """The folder of the model that served before, if it is on disk."""
        digest = self._model.answer.fallback if self._model else None
        return self._models(digest) if digest and self._models(digest).is_dir() else None

    def refresh(self) -> Model:
        """Ask once, now. Raises ClientError, and leaves the last good model where it is."""
        url, token, timeout_s = self._address
        client = Client(url, timeout_s=timeout_s, token=token)
        try:
            if self._witness.key is None:
                self._witness.pin(client.audit_key())
            envelope = client.serving_envelope(self._plant)
            answer, checkpoint = self._witness.believed(
                lambda key: self._opened(envelope, key), client.endorsements
            )
            self._witness.see(checkpoint, client.consistency)
            self._require_later(answer)
            self._highest = answer.generation, answer.artifact
            _write(
                self._folder / "highest.json", list(self._highest)
            )  # before anything that may fail: an older one cannot come back
            for digest in (answer.artifact, answer.fallback):
                if digest and not is_whole(self._models(digest), digest):
                    self._fetch(client, digest)
            if (
                self._model is None
                or answer.generation > self._model.answer.generation
                or answer.issued_at > self._model.answer.issued_at
            ):
                _write(self._folder / "serving.json", envelope)
                self._model = Model(self._models(answer.artifact), answer)
            return self._model
        finally:
            client.close()

    def start(self, interval_s: float = LOOK_S) -> None:
        """Look for a newer answer every `interval_s` [s], in a thread that ends with the
        process."""
        threading.Thread(target=self._look, args=(interval_s,), daemon=True).start()

    def stop(self) -> None:
        """Look no more."""
        self._stop.set()

    def _look(self, interval_s: float) -> None:
        while not self._stop.is_set():
            try:
                self.refresh()
                self.problem = None
            except Exception as error:  # noqa: BLE001  (whatever it is, the robot goes on, and asks again)
                self.problem = error
            self._stop.wait(interval_s)

    def _opened(self, envelope: Envelope, key: Key) -> tuple[Answer, str]:
        """The answer in an envelope, and the checkpoint beside it. Raises NotSigned."""
        found = key.payload(envelope, ENVELOPE_TYPE)
        if found.get("schema") != SCHEMA or found.get("plant") != self._plant:
            raise NotSigned(f"the answer is not for plant {self._plant!r}")
        return Answer(**{name: found[name] for name in Answer.__slots__}), found["checkpoint"]

    def _require_later(self, answer: Answer) -> None:
        """Raises LogForked for an answer older than one that was seen, or another artifact under
        its generation, NotSigned if expired."""
        if not answer.is_current(self._clock()):
            raise NotSigned(
                f"the answer expired at {answer.expires_at}: it is an old one, or a clock is wrong"
            )
        generation, artifact = self._highest
        if answer.generation < generation or (
            answer.generation == generation and answer.artifact != artifact
        ):
            raise LogForked(
                f"generation {answer.generation} was answered after generation {generation}"
            )

    def _fetch(self, client: Client, digest: str) -> None:
        beside = self._models(f"{digest}.{uuid.uuid4().hex}.part")
        beside.parent.mkdir(exist_ok=True)
        client.fetch(self._plant, digest, beside)  # every file of it is synced
        shutil.rmtree(self._models(digest), ignore_errors=True)  # one that was damaged
        beside.replace(self._models(digest))
        sync_folder(beside.parent)

    def _kept(self) -> Model | None:
        """The last good model of an earlier run; None where there is none, or it was damaged."""
        for key in (
            self._witness.keys
        ):  # an answer of before the key was replaced is still the last good one
            try:
                answer, _ = self._opened(
                    json.loads((self._folder / "serving.json").read_text()), key
                )
            except (OSError, ValueError, NotSigned):
                continue
            folder = self._models(answer.artifact)
            return Model(folder, answer) if is_whole(folder, answer.artifact) else None
        return None

    def _seen(self) -> tuple[int, str]:
        """The highest generation that was seen, and its artifact."""
        kept = (
            (self._model.answer.generation, self._model.answer.artifact) if self._model else (0, "")
        )
        try:
            generation, artifact = json.loads((self._folder / "highest.json").read_text())
        except (OSError, ValueError):
            return kept
        return max(kept, (int(generation), str(artifact)))

    def _models(self, digest: str) -> Path:
        return self._folder / "models" / digest


def _write(path: Path, document: Any) -> None:
    """Write a document beside, sync it, then give it its name."""
    beside = path.with_name(f"{path.name}.{uuid.uuid4().hex}")
    with beside.open("w") as file:
        json.dump(document, file)
        file.flush()
        os.fsync(file.fileno())
    beside.replace(path)
    sync_folder(path.parent)
