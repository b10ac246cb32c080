"""Notebook: the whole job in a few lines of Python, without a server and without files.

`trueup.diagnose` is a package and, as one says `diagnose` in a notebook, a function: this makes the
package callable.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

import trueup.diagnose as _package


class _CallablePackage(ModuleType):
    """A package that does what the function of its name does."""

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        """What `trueup.notebook.diagnosis.diagnose` does."""
        from trueup.notebook.diagnosis import diagnose  # noqa: PLC0415  (which imports this)

        return diagnose(*arguments, **named)


sys.modules[_package.__name__].__class__ = _CallablePackage
