"""What a robot runs: it keeps the model to use on disk, verified, and asks the service in a thread.

The robot goes on with its last good model for as long as the service is away.

    robot = Robot("http://registry:8321", "cell-7", "/var/lib/trueup", key="trueup-…+…+…")
    robot.start()                     # looks for a newer answer in a thread of its own
    while True:
        model = robot.current()       # at once, from what is on disk; None before the first answer

An answer counts only if the log's key signed it for this plant, and its generation is not behind
one that was seen. Its artifact is fetched and verified before it replaces the last good one. Each
answer carries the log's checkpoint, and the robot is a witness of it.
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

from trueup_client.client import Client
from trueup_client.files import is_whole, sync_folder
from trueup_client.problem import LogForked, NotSigned
from trueup_client.proof import Key
from trueup_client.records import Envelope
from trueup_client.witness import Witness

ENVELOPE_TYPE, SCHEMA = "application/vnd.trueup.serving+json", "trueup.serving/1"
REFRESH_S = 30.0


def _now() -> datetime:
    return datetime.now(UTC)


@dataclass(frozen=True, slots=True)
class Answer:
    """Which artifact a plant's robot is to use.

    `expires_at` is when the answer stops being current; `fallback` is the artifact that served
    before. Times are UTC, ISO 8601.
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
        """Whether the answer has not expired."""
        return now < datetime.fromisoformat(self.expires_at)


@dataclass(frozen=True, slots=True)
class Model:
    """A verified model on disk: manifest.json and arrays.safetensors are in `folder`."""

    folder: Path
    answer: Answer


class Robot:
    """Keeps the last good model of a plant in a folder, and the one before it as the fallback.

    `key` is the log's public key (`trueup key`). Without it the first key seen is trusted.
    `problem` says why the last refresh changed nothing; None if it went well.
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
        self._model = self._stored_model()
        self._highest = self._stored_highest()
        self.problem: Exception | None = None

    def current(self) -> Model | None:
        """Returns the last good model without asking the service; None if there is none."""
        return self._model

    def is_current(self) -> bool:
        """Whether the last answer has not expired.

        A robot whose answer has expired keeps its model, and should report it.
        """
        return self._model is not None and self._model.answer.is_current(self._clock())

    def fallback(self) -> Path | None:
        """Returns the folder of the model that served before; None if it is not on disk."""
        digest = self._model.answer.fallback if self._model else None
        return self._models(digest) if digest and self._models(digest).is_dir() else None

    def refresh(self) -> Model:
        """Asks the service once. On a ClientError the last good model stays as it is."""
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
            # written before anything that may fail: an older answer cannot come back
            _write(self._folder / "highest.json", list(self._highest))
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

    def start(self, interval_s: float = REFRESH_S) -> None:
        """Refreshes every `interval_s` [s], in a thread that ends with the process."""
        threading.Thread(target=self._run, args=(interval_s,), daemon=True).start()

    def stop(self) -> None:
        """Ends the thread that `start` began."""
        self._stop.set()

    def _run(self, interval_s: float) -> None:
        while not self._stop.is_set():
            try:
                self.refresh()
                self.problem = None
            except Exception as error:  # noqa: BLE001  (the robot goes on, and asks again)
                self.problem = error
            self._stop.wait(interval_s)

    def _opened(self, envelope: Envelope, key: Key) -> tuple[Answer, str]:
        """Returns the answer in an envelope, and its checkpoint. Raises NotSigned."""
        document = key.payload(envelope, ENVELOPE_TYPE)
        if document.get("schema") != SCHEMA or document.get("plant") != self._plant:
            raise NotSigned(f"the answer is not for plant {self._plant!r}")
        fields = {name: document[name] for name in Answer.__slots__}
        return Answer(**fields), document["checkpoint"]

    def _require_later(self, answer: Answer) -> None:
        """Raises NotSigned if an answer has expired.

        Raises LogForked if it is older than one that was seen, or names another artifact under the
        same generation.
        """
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
        partial = self._models(f"{digest}.{uuid.uuid4().hex}.part")
        partial.parent.mkdir(exist_ok=True)
        client.fetch(self._plant, digest, partial)  # which syncs every file
        shutil.rmtree(self._models(digest), ignore_errors=True)  # one that was damaged
        partial.replace(self._models(digest))
        sync_folder(partial.parent)

    def _stored_model(self) -> Model | None:
        """Returns the last good model of an earlier run; None if there is none or it is damaged."""
        # an answer from before the key was replaced is still the last good one
        for key in self._witness.keys:
            try:
                answer, _ = self._opened(
                    json.loads((self._folder / "serving.json").read_text()), key
                )
            except (OSError, ValueError, NotSigned):
                continue
            folder = self._models(answer.artifact)
            return Model(folder, answer) if is_whole(folder, answer.artifact) else None
        return None

    def _stored_highest(self) -> tuple[int, str]:
        """Returns the highest generation that was seen, and its artifact."""
        answer = self._model.answer if self._model else None
        of_model = (answer.generation, answer.artifact) if answer else (0, "")
        try:
            generation, artifact = json.loads((self._folder / "highest.json").read_text())
        except (OSError, ValueError):
            return of_model
        return max(of_model, (int(generation), str(artifact)))

    def _models(self, digest: str) -> Path:
        return self._folder / "models" / digest


def _write(path: Path, document: Any) -> None:
    """Writes a JSON document under a temporary name, syncs it, then renames it."""
    partial = path.with_name(f"{path.name}.{uuid.uuid4().hex}")
    with partial.open("w") as file:
        json.dump(document, file)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)
    sync_folder(path.parent)
