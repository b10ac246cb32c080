"""trueup: find where a robot's dynamics model is wrong, correct it, and promote the correction only
if it earns it.

    Episode -> Fit -> Candidate -> Decision -> ServingPointer -> AuditLog

Each step is a function that takes the product before it and returns the next. This package is pure:
it opens no socket, database, process or clock, and reads no environment.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from trueup.artifact.model import Model, load
    from trueup.model.effect import load_effect
    from trueup.model.simulator.simulator import load_simulator
    from trueup.notebook.case import Case
    from trueup.notebook.compare import Comparison, compare
    from trueup.notebook.conversion import convert
    from trueup.notebook.diagnosis import Diagnosis, diagnose
    from trueup.notebook.excitations import Allowed, Experiment, excite
    from trueup.notebook.models import (
        FirstModel,
        Inertia,
        Oscillator,
        Pendulum,
        Robot,
        Simulator,
    )
    from trueup.notebook.trials import BlindTrial, blind_trial

__all__ = [
    "Allowed",
    "BlindTrial",
    "Case",
    "Comparison",
    "Diagnosis",
    "Experiment",
    "FirstModel",
    "Inertia",
    "Model",
    "Oscillator",
    "Pendulum",
    "Robot",
    "Simulator",
    "blind_trial",
    "compare",
    "convert",
    "diagnose",
    "excite",
    "load",
    "load_effect",
    "load_simulator",
]
__version__ = "0.1.0"

_MODULES = {
    "Model": "trueup.artifact.model",
    "load": "trueup.artifact.model",
    "Allowed": "trueup.notebook.excitations",
    "load_effect": "trueup.model.effect",
    "load_simulator": "trueup.model.simulator.simulator",
    "BlindTrial": "trueup.notebook.trials",
    "Case": "trueup.notebook.case",
    "Comparison": "trueup.notebook.compare",
    "blind_trial": "trueup.notebook.trials",
    "compare": "trueup.notebook.compare",
    "convert": "trueup.notebook.conversion",
    "Diagnosis": "trueup.notebook.diagnosis",
    "diagnose": "trueup.notebook.diagnosis",
    "Experiment": "trueup.notebook.excitations",
    "excite": "trueup.notebook.excitations",
    "FirstModel": "trueup.notebook.models",
    "Inertia": "trueup.notebook.models",
    "Oscillator": "trueup.notebook.models",
    "Pendulum": "trueup.notebook.models",
    "Robot": "trueup.notebook.models",
    "Simulator": "trueup.notebook.models",
}


def __getattr__(name: str) -> Any:
    """What `__all__` names, brought when it is asked for: a program that only serves needs no
    numpy."""
    if name not in _MODULES:
        raise AttributeError(f"module 'trueup' has no attribute {name!r}")
    from importlib import import_module  # noqa: PLC0415

    return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
