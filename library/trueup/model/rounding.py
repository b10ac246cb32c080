"""Rounding: what a linear solve's last bit decides is cut off, so that fits take the same way on
every processor.

Two processors sum in another order, and their solutions differ in the last bits. A fit through
kinks, as dry friction makes, would carry such a difference to another minimum. So steps and first
guesses are rounded to a few bits before anything is rolled out from them: a step that is off by one
part in four thousand is as good a step, and from equal places a rollout, which sums in one order,
goes on alike.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

# of a step: one part in 4,000 costs no iteration, and a solve's error, 1e-13 or so, seldom decides
# between two of them
STEP_BITS = 12
GUESS_BITS = 24  # of a first guess, which is taken as it is


def rounded(x: NDArray[np.float64] | float, bits: int = STEP_BITS) -> Any:
    """Numbers with so many bits of their mantissas, as many as were given; infinities and nan as
    they are."""
    mantissa, exponent = np.frexp(x)
    return np.ldexp(np.rint(mantissa * 2.0**bits), exponent - bits)
