"""trueup: find where a robot's dynamics model is wrong, correct it, and promote the correction only
if it earns it.

    Episode -> Fit -> Candidate -> Decision -> ServingPointer -> AuditLog

Each step is a function that takes the product before it and returns the next. This package is pure:
it opens no socket, database, process or clock, and reads no environment.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from trueup.artifact.model import Model, load

__all__ = ["Model", "load"]
__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    """`trueup.load` and `trueup.Model`, brought when they are asked for: a program that only serves
    needs no numpy."""
    if name not in __all__:
        raise AttributeError(f"module 'trueup' has no attribute {name!r}")
    from trueup.artifact import model  # noqa: PLC0415

    return getattr(model, name)
