"""What a robot runs: which model to use, verified, from disk; the service is asked beside, and may be away for ever.

    robot = Robot("http://registry:8321", "cell-7", "/var/lib/trueup", key="trueup-…+…+…")
    robot.start()                     # looks for a newer answer in a thread of its own
    while True:
        model = robot.current()       # at once, from what is on disk; None before the first answer

An answer counts only if the log's key signed it, for this plant, and its generation is not behind one that was seen. Its artifact is
fetched and verified before it takes the place of the last good one. Each answer brings the log's checkpoint: the robot is a witness of it.
"""

from __future__ import annotations

import json
import os
import threading
import uuid
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from trueup_client.client import Client
from trueup_client.problem import ClientError, NotSigned, Rewritten
from trueup_client.witness import Witness

ENVELOPE_TYPE, SCHEMA = "application/vnd.trueup.serving+json", "trueup.serving/1"
LOOK_S = 30.0


def _now() -> datetime:
    return datetime.now(UTC)


@dataclass(frozen=True, slots=True)
class Answer:
    """What a plant's robot is to use.

    `expires_at` is when the answer stops being current; `fallback` is the artifact that served before.
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

    `key` is the log's public key (`trueup key`); without it the first one seen is believed from then on.
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
        self.problem: Exception | None = None  # why the last look changed nothing, None where it went well

    def current(self) -> Model | None:
        """The last good model; never asks the service, never waits."""
        return self._model

    def is_current(self) -> bool:
        """Whether the service said so lately enough; a robot whose answer has expired keeps its model, and should say so."""
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
            answer, checkpoint = self._opened(envelope)
            self._witness.see(checkpoint, client.consistency)
            self._require_later(answer)
            for digest in (answer.artifact, answer.fallback):
                if digest and not self._models(digest).is_dir():
                    self._fetch(client, digest)
            self._keep(envelope)
            self._model = Model(self._models(answer.artifact), answer)
            return self._model
        finally:
            client.close()

    def start(self, interval_s: float = LOOK_S) -> None:
        """Look for a newer answer every `interval_s` [s], in a thread that ends with the process."""
        threading.Thread(target=self._look, args=(interval_s,), daemon=True).start()

    def stop(self) -> None:
        """Look no more."""
        self._stop.set()

    def _look(self, interval_s: float) -> None:
        while not self._stop.is_set():
            try:
                self.refresh()
                self.problem = None
            except (ClientError, OSError) as error:
                self.problem = error
            self._stop.wait(interval_s)

    def _opened(self, envelope: dict[str, Any]) -> tuple[Answer, str]:
        """The answer in an envelope, and the checkpoint beside it. Raises NotSigned."""
        if self._witness.key is None:
            raise NotSigned("no key is pinned yet")
        found = self._witness.key.payload(envelope, ENVELOPE_TYPE)
        if found.get("schema") != SCHEMA or found.get("plant") != self._plant:
            raise NotSigned(f"the answer is not for plant {self._plant!r}")
        return Answer(**{name: found[name] for name in Answer.__slots__}), found["checkpoint"]

    def _require_later(self, answer: Answer) -> None:
        """Raises Rewritten for an answer older than the one in use, or another artifact under its generation."""
        before = self._model.answer if self._model else None
        if before is None or answer.generation > before.generation:
            return
        if (answer.generation, answer.artifact) != (before.generation, before.artifact) or answer.issued_at < before.issued_at:
            raise Rewritten(f"generation {answer.generation} was answered after generation {before.generation}")

    def _fetch(self, client: Client, digest: str) -> None:
        beside = self._models(f"{digest}.{uuid.uuid4().hex}.part")
        beside.parent.mkdir(exist_ok=True)
        client.fetch(self._plant, digest, beside)
        beside.replace(self._models(digest))

    def _keep(self, envelope: dict[str, Any]) -> None:
        path = self._folder / "serving.json"
        beside = path.with_name(f"{path.name}.{uuid.uuid4().hex}")
        with beside.open("w") as file:
            json.dump(envelope, file)
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)

    def _kept(self) -> Model | None:
        """The last good model of an earlier run; None where there is none, or it was damaged."""
        path = self._folder / "serving.json"
        try:
            answer, _ = self._opened(json.loads(path.read_text()))
        except (OSError, ValueError, NotSigned):
            return None
        folder = self._models(answer.artifact)
        return Model(folder, answer) if folder.is_dir() else None

    def _models(self, digest: str) -> Path:
        return self._folder / "models" / digest
