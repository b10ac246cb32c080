"""Which workers compute the same bits: those with the same code, libraries and processor."""

from __future__ import annotations

import platform
from functools import cache

import llvmlite.binding as llvm
import numba
import numpy as np

from trueup.canonical import Json, digest_of
from trueup_worker.code_identity import code_identity


@cache
def likeness() -> str:
    """A digest that two workers share only if they compute the same: kernels are compiled for the
    processor at hand."""
    found: dict[str, Json] = {
        "code": code_identity(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba.__version__,
        "processor": llvm.get_host_cpu_name(),
        "features": llvm.get_host_cpu_features().flatten(),
    }
    return digest_of(found)
