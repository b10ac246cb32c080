"""The identity of the code that computed a result, and of the libraries that it runs on."""

from __future__ import annotations

import hashlib
import platform
from functools import cache
from importlib.metadata import version
from pathlib import Path

import trueup
from trueup.canonical import Json


@cache
def code_identity() -> dict[str, Json]:
    """Returns the library's version, and the SHA-256 of the names and bytes of its source files."""
    root = Path(trueup.__file__).parent
    hashed = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        hashed.update(
            path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes() + b"\0"
        )
    return {"version": trueup.__version__, "sha256": hashed.hexdigest()}


@cache
def library_versions() -> dict[str, Json]:
    """Returns the versions of Python and of the libraries that load and run a model."""
    return {
        "python": platform.python_version(),
        **{name: version(name) for name in ("numpy", "numba", "safetensors")},
    }
