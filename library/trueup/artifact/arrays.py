"""Arrays to safetensors bytes and back, bit for bit.

Two traps of the format's writer are avoided here: it stores strided and Fortran-ordered arrays
wrongly without an error, and orders metadata at random. So arrays are made C-contiguous, no
metadata is written, and the written bytes are read back.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load, save

from trueup.errors import BadArtifact

Array = NDArray[np.float64]


def arrays_to_bytes(arrays: Mapping[str, Array]) -> bytes:
    """Safetensors bytes of float64 arrays, the same for the same arrays; empty for none."""
    if not arrays:
        return b""
    plain = {name: np.array(arrays[name], dtype=np.float64, order="C") for name in sorted(arrays)}
    data: bytes = save(plain)
    back = arrays_from_bytes(data)
    if any(
        back[name].tobytes() != plain[name].tobytes() or back[name].shape != plain[name].shape
        for name in plain
    ):
        raise BadArtifact(
            "the arrays did not survive being written",
            hint="Report this: the array writer is at fault.",
        )
    return data


def arrays_from_bytes(data: bytes) -> dict[str, Array]:
    """The arrays of safetensors bytes. Raises BadArtifact for anything that is no float64
    safetensors file."""
    if not data:
        return {}
    try:
        arrays: dict[str, Array] = load(data)
    except (SafetensorError, ValueError, KeyError, TypeError) as error:
        raise BadArtifact(f"the arrays cannot be read: {error}") from error
    if any(a.dtype != np.float64 for a in arrays.values()):
        raise BadArtifact("an array is not float64")
    return arrays
