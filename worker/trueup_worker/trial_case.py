"""A case of a blind trial as a part of its job: the files that the diagnosis is given, and its
answer, as blobs."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import orjson

from trueup.canonical import Json
from trueup_service.wiring import Parts, keep_bytes
from trueup_worker.isolated_process import IsolatedProcess


def keep_case(parts: Parts, folder: Path) -> dict[str, Json]:
    """Stores the files of a case, and returns what its part is asked."""
    return {
        "files": {
            file.name: keep_bytes(parts, file.read_bytes()) for file in sorted(folder.iterdir())
        }
    }


def diagnose_case(parts: Parts, process: IsolatedProcess, asked: Mapping[str, Any]) -> str:
    """Returns the digest of what an isolated process answered about a case."""
    with tempfile.TemporaryDirectory(prefix="case-") as folder:
        for name, digest in asked["files"].items():
            (Path(folder) / name).write_bytes(parts.blobs.get(digest))
        answer = process(Path(folder), parts.settings.job_time_limit_s)
    return keep_bytes(parts, orjson.dumps(answer))


def read_answer(parts: Parts, digest: str) -> Mapping[str, Any]:
    """Returns what an isolated process answered."""
    answer: Mapping[str, Any] = orjson.loads(parts.blobs.get(digest))
    return answer
