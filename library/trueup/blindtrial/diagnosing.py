"""Diagnose a case folder, and answer in what can be passed between processes."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from trueup.artifact.artifact import pack
from trueup.diagnose.case import read_case
from trueup.diagnose.diagnosis import diagnose
from trueup.errors import TrueupError


def answer_of(folder: Path, clock_s: Callable[[], float]) -> Mapping[str, Any]:
    """The `report`, `manifest` and `arrays` (base64) of a diagnosis, or a `problem`; and `seconds`
    by the clock [s]. Raises nothing: a diagnosis that breaks is one miss."""
    began = clock_s()
    try:
        diagnosis = diagnose(*read_case(folder))
        model = pack(diagnosis.predictor, {"origin": "diagnosis"})
    except TrueupError as error:
        return {"problem": f"{error.code}: {error.message}", "seconds": clock_s() - began}
    except Exception as error:  # noqa: BLE001  (a diagnosis that breaks is one miss)
        problem = f"failed: {type(error).__name__}: {error}"
        return {"problem": problem, "seconds": clock_s() - began}
    return {
        "report": dict(diagnosis.document),
        "manifest": model.manifest.decode(),
        "arrays": b64encode(model.arrays).decode(),
        "seconds": clock_s() - began,
    }
