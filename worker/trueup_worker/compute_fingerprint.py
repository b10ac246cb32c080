"""The compute fingerprint: workers that share one compute the same bits."""

from __future__ import annotations

import platform
from functools import cache

import llvmlite.binding as llvm
import numba
import numpy as np

from trueup.canonical import Json, digest_of
from trueup.code_identity import code_identity


@cache
def compute_fingerprint() -> str:
    """Returns a digest of this worker's code, libraries and processor.

    The processor is part of it because kernels are compiled for the processor at hand.
    """
    document: dict[str, Json] = {
        "code": code_identity(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba.__version__,
        "processor": llvm.get_host_cpu_name(),
        "features": llvm.get_host_cpu_features().flatten(),
    }
    return digest_of(document)
