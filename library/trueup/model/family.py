"""Family: the form of a nominal model of one joint. Each file in `families/` holds one; they are
found by themselves."""

from __future__ import annotations

import hashlib
import importlib
import inspect
import pkgutil
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar


@dataclass(frozen=True, slots=True)
class Param:
    """A number of the model: its symbol, its unit, the least value it may take, and what people
    call it."""

    name: str
    unit: str
    low: float = float("-inf")
    called: str = ""


class Family(ABC):
    """Acceleration of one joint as a pure function of position, velocity and applied command.

    `acceleration` uses numpy functions only, so that the same text runs on floats, on arrays and
    compiled. `regressors` gives its derivative by each parameter: every family is linear in its
    parameters.
    """

    name: ClassVar[str]
    params: ClassVar[tuple[Param, ...]]
    # each parameter times what it multiplies, as a feature, in the order of `params`
    products: ClassVar[tuple[str, ...]]

    @staticmethod
    @abstractmethod
    def acceleration(q: Any, v: Any, u: Any, *parameters: Any) -> Any:
        """Acceleration [position unit / s^2]."""

    @staticmethod
    @abstractmethod
    def regressors(q: Any, v: Any, u: Any) -> tuple[Any, ...]:
        """The factor of each parameter in the acceleration, in the order of `params`."""


@cache
def families() -> dict[str, type[Family]]:
    """Every family there is, by name."""
    from trueup.model import families as package  # noqa: PLC0415  (the files import this module)

    for module in pkgutil.iter_modules(package.__path__):
        importlib.import_module(f"{package.__name__}.{module.name}")
    return {f.name: f for f in sorted(Family.__subclasses__(), key=lambda f: f.name)}


def source_digest(function: Callable[..., Any]) -> str:
    """Digest of the file that defines a function: compiled code is kept only as long as its
    text."""
    return hashlib.sha256(
        inspect.getsource(inspect.getmodule(function) or function).encode()
    ).hexdigest()
