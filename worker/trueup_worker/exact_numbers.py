"""Arrays of numbers as JSON that gives them back bit for bit, infinities included."""

from __future__ import annotations

from base64 import b64decode, b64encode
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json


def to_json(numbers: NDArray[np.float64]) -> Json:
    """Returns an array as its shape and its bytes."""
    plain = np.ascontiguousarray(numbers, np.float64)
    return {"shape": list(plain.shape), "bytes": b64encode(plain.tobytes()).decode()}


def from_json(document: Any) -> NDArray[np.float64]:
    """Returns the array that `to_json` was given."""
    return np.frombuffer(b64decode(document["bytes"]), np.float64).reshape(document["shape"])
