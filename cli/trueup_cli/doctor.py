"""`trueup doctor`: what is wrong with a case's recordings; without a case, what is installed, and
what a missing part is needed for."""

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
    """One part of the installation: its state, its use, and what to do if it is missing."""

    part: str
    found: str
    ok: bool
    needed: bool
    used_for: str
    do: str = ""


def findings() -> list[Finding]:
    """Checks every part of the installation."""
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
    (
        "pyarrow",
        False,
        "recordings in Parquet, LeRobot datasets",
        "pip install 'trueup[tables]'",
    ),
    ("h5py", False, "recordings in HDF5", "pip install 'trueup[tables]'"),
    (
        "rosbags",
        False,
        "ROS messages other than JointState, ROS 1 bags",
        "pip install 'trueup[ros]'",
    ),
    ("matplotlib", False, "pictures of a diagnosis in a notebook", "pip install 'trueup[plot]'"),
    (
        "opentelemetry.sdk",
        False,
        "traces and metrics of the service over OTLP",
        "pip install 'trueup-service[otlp]'",
    ),
    (
        "authlib",
        False,
        "people who sign in at an OpenID provider",
        "pip install 'trueup-service[openid]'",
    ),
    ("mlflow", False, "versions to and from an MLflow registry", "pip install 'trueup[mlflow]'"),
    ("oras", False, "models and archives in an OCI registry", "pip install 'trueup[oci]'"),
    ("onnx", False, "models written as ONNX", "pip install 'trueup[onnx]'"),
    ("pythonfmu3", False, "models written as units of FMI 3.0", "pip install 'trueup[fmu]'"),
    ("pxr", False, "layers over a robot's USD asset", "pip install 'trueup[usd]'"),
    (
        "onnxruntime",
        False,
        "simulators given as ONNX",
        "pip install 'trueup[simulator]'",
    ),
)


def _python() -> Finding:
    version = ".".join(map(str, sys.version_info[:3]))
    is_new = sys.version_info >= PYTHON
    return Finding(
        "python",
        version,
        is_new,
        True,
        "everything",
        "" if is_new else "Install Python 3.11 or newer.",
    )


def _package(name: str, needed: bool, used_for: str, do: str) -> Finding:
    top = name.partition(".")[0]
    if importlib.util.find_spec(top) is None or importlib.util.find_spec(name) is None:
        return Finding(name, "missing", False, needed, used_for, do)
    distribution = importlib.metadata.packages_distributions()[top][0]
    version = importlib.metadata.version(distribution)
    return Finding(name, version, True, needed, used_for)


def _cache() -> Finding:
    """Checks that compiled rollouts can be cached; else each process compiles them anew."""
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


def doctor(
    case: Path | None = None,
    *,
    mend: Path | None = None,
    strict: bool = False,
    as_json_: Json = False,
) -> None:
    """Look for faults in the recordings of a case: units, signs, scales, order, stamps, samples.

    Without a case, show what is installed, and what a missing part is needed for; the exit code is
    then 1 if a needed part is missing.

    Parameters
    ----------
    case
        folder with plant.json and *.mcap episodes
    mend
        folder to write the case to with every mend applied; the recordings of CASE stay as they are
    strict
        exit with 1 if anything was found
    """
    if case is None:
        _installation(as_json_=as_json_)
        return
    from trueup_cli.examination import examined, show
    from trueup_cli.examination import mend as write_mended

    result = examined(case)
    if mend is not None:
        write_mended(result, mend)
    show(result, mend, json_=as_json_)
    if strict and result.findings:
        raise SystemExit(REFUSED)


def _installation(*, as_json_: bool) -> None:
    """Shows every part of the installation."""
    parts = findings()
    if as_json_:
        as_json([asdict(f) for f in parts])
    else:
        rows = [
            (
                f.part,
                f.found,
                "ok" if f.ok else "missing" if f.needed else "not installed",
                f.used_for,
                f.do,
            )
            for f in parts
        ]
        table("This installation", ["part", "found", "state", "used for", "what to do"], rows)
    missing = [f.part for f in parts if f.needed and not f.ok]
    if missing:
        say("[red]{} {} needed[/]", ", ".join(missing), "is" if len(missing) == 1 else "are")
        raise SystemExit(REFUSED)
