"""`trueup doctor`: what this installation has, and what is missing for what."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

from trueup_cli.exits import REFUSED
from trueup_cli.options import Json
from trueup_cli.show import as_json, say, table

PYTHON = (3, 11)


@dataclass(frozen=True, slots=True)
class Finding:
    """One part of the installation: what was found, what it is for, and what to do where it is
    missing."""

    part: str
    found: str
    ok: bool
    needed: bool
    used_for: str
    do: str = ""


def findings() -> list[Finding]:
    """Every part that is looked at."""
    return [_python(), *(_package(*p) for p in PACKAGES), _cache()]


PACKAGES = (
    ("numba", True, "rollouts, fits, diagnoses", "pip install trueup"),
    ("mcap", True, "reading recordings", "pip install trueup"),
    ("dbos", False, "running the service: its jobs", "pip install 'trueup-cli[server]'"),
    (
        "psycopg",
        False,
        "running the service: storage in PostgreSQL",
        "pip install 'trueup-cli[server]'",
    ),
    ("mujoco", False, "robots given as MJCF or URDF", "pip install 'trueup[mujoco]'"),
    ("mlflow", False, "versions to and from an MLflow registry", "pip install 'trueup[mlflow]'"),
    ("onnx", False, "models written as ONNX", "pip install 'trueup[onnx]'"),
)


def _python() -> Finding:
    version = ".".join(map(str, sys.version_info[:3]))
    fine = sys.version_info >= PYTHON
    return Finding(
        "python", version, fine, True, "everything", "" if fine else "Install Python 3.11 or newer."
    )


def _package(name: str, needed: bool, used_for: str, do: str) -> Finding:
    there = importlib.util.find_spec(name) is not None
    found = (
        importlib.metadata.version(importlib.metadata.packages_distributions()[name][0])
        if there
        else "missing"
    )
    return Finding(name, found, there, needed, used_for, "" if there else do)


def _cache() -> Finding:
    """Whether compiled rollouts can be kept: else each process compiles them anew."""
    spec = importlib.util.find_spec("trueup")
    assert spec is not None
    assert spec.submodule_search_locations
    folder = Path(os.environ.get("NUMBA_CACHE_DIR") or spec.submodule_search_locations[0])
    writable = os.access(folder, os.W_OK)
    do = "" if writable else "Set NUMBA_CACHE_DIR to a folder that can be written."
    return Finding(
        "kernel cache",
        str(folder),
        writable,
        False,
        "rollouts compiled once, not in each process",
        do,
    )


def doctor(*, as_json_: Json = False) -> None:
    """Say what this installation has, and what is missing for what. Exit code 1 where a needed part
    is missing."""
    found = findings()
    if as_json_:
        as_json([asdict(f) for f in found])
    else:
        rows = [
            (
                f.part,
                f.found,
                "ok" if f.ok else "missing" if f.needed else "not installed",
                f.used_for,
                f.do,
            )
            for f in found
        ]
        table("This installation", ["part", "found", "state", "used for", "what to do"], rows)
    missing = [f.part for f in found if f.needed and not f.ok]
    if missing:
        say("[red]{} {} needed[/]", ", ".join(missing), "is" if len(missing) == 1 else "are")
        raise SystemExit(REFUSED)
