"""Effect: something that the nominal model leaves out, as a small pure function at a port.

A file in `effects/` holds one; they are found by themselves. What `apply` takes is told by the
names of its arguments:

    signals      `u` command, `q` position, `v` velocity, `t` time since the episode began [s], `h`
                 step [s], `lag_s` transport delay [s], `period` of the samples [s], `since` the
                 last one [s], 0 at the first, `u_scale` the command's declared limit, `implicit` 1
                 where a step takes its end's values, `passive` and `drive` the nominal acceleration
                 without and by the command, `spring` the passive one at rest, in a robot with what
                 centrifugal and Coriolis forces add, `mobility` the acceleration that a unit of
                 force brings about: 1 but in a tree, whose inertia changes with its pose
    states       the names in `states`: what the effect remembers of the episode's past
    parameters   the names in `params`

It returns its port's signal, then its states. A friction returns the level up to which it holds or
brakes: the step itself keeps it from reversing the motion, for any number of frictions at one
joint. Ports act in this order: timing, command, force and friction, observation; within a port by
`order`, from the controller's side to the joint's.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import inspect
import pkgutil
import re
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from importlib.metadata import entry_points
from os import PathLike
from pathlib import Path
from typing import Any, ClassVar

from trueup.errors import BadEffect

NAME = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*")
INFINITY = float("inf")
NULL = float("nan")  # in a start: the number begins at its null


class Port(StrEnum):
    """Where an effect acts."""

    TIMING = "timing"
    COMMAND = "command"
    FORCE = "force"
    FRICTION = "friction"  # reported as force: a force that can hold but never push
    OBSERVATION = "observation"

    @property
    def reported(self) -> str:
        """The port's name in a report."""
        return "force" if self is Port.FRICTION else str(self)


SIGNALS = {
    Port.TIMING: ("h",),
    Port.COMMAND: ("u",),
    Port.FORCE: ("a",),
    Port.FRICTION: ("level",),
    Port.OBSERVATION: ("q", "v"),
}
# what an effect returns instead of its port's signal where it is a pure transport delay
DELAYS = ("lag_s",)


class Scale(StrEnum):
    """What a parameter is measured against: the plant's own motion, so that nothing assumes newton
    metres."""

    ACCELERATION = "acceleration"
    VELOCITY = "velocity"
    POSITION = "position"
    COMMAND = "command"
    DRIVE = "command, or a servo's error"
    RATE = "command / s"
    TIME = "s"
    ONE = "1"
    DRAG = "acceleration / velocity^2"
    CUBIC = "acceleration / position^3"
    DRIFT = "position / s"
    STIFFNESS = "acceleration / position"
    DAMPING = "acceleration / velocity"


@dataclass(frozen=True, slots=True)
class Number:
    """A parameter of an effect: its scale, the value at which the effect vanishes, its range in
    units of the scale, and what people call it where its name alone does not say."""

    name: str
    scale: Scale
    null: float = 0.0
    low: float = 0.0
    high: float = INFINITY
    called: str = ""

    @property
    def label(self) -> str:
        """What people call it."""
        return self.called or self.name.replace("_", " ")


def equation_in(docstring: str | None) -> str:
    """The equation that a docstring gives, in one line; empty where it gives none."""
    after = (docstring or "").partition("Equation:")[2].partition("Source:")[0]
    return " ".join(after.split())


@cache
def _arguments(of: Callable[..., Any]) -> tuple[str, ...]:
    return tuple(inspect.signature(of).parameters)


class Effect(ABC):
    """One unmodelled effect. `starts` are the values, in units of each parameter's scale, from
    which a fit begins.

    `threshold` names the parameters along which the error has corners: their finite differences are
    wider. `grid_refined` is one between whose corners the error is flat: ever finer grids find it.
    `counted` ones are found in the samples themselves, `periodic` ones by a scan along the travel;
    one that is the `same_as` another on every log is fitted as that one, and told as an alternative
    to it. A `late` one makes a topic late, as drives and buses of any machine may besides whatever
    else acts: it is tried beside the best composition of a machine however large that is. What a
    state was before the log began is estimated, in units of its `memory` scale, from
    where it `begins`. Where the effect `hides_velocity`, the log shows the velocity with the first
    state added, and the second is the velocity of the sample before.
    """

    name: ClassVar[str]
    port: ClassVar[Port]
    category: ClassVar[str]
    in_mjcf: ClassVar[str] = "no element of MJCF does this"  # what a person can write instead
    order: ClassVar[int] = 0
    params: ClassVar[tuple[Number, ...]]
    states: ClassVar[tuple[str, ...]] = ()
    # Of each state: "zero", the signal that it starts from, or "first": what it was does not matter
    begins: ClassVar[tuple[str, ...]] = ()
    memory: ClassVar[tuple[Scale, ...]] = ()
    starts: ClassVar[tuple[tuple[float, ...], ...]]
    threshold: ClassVar[tuple[str, ...]] = ()
    grid_refined: ClassVar[str] = ""
    # Numbers that stay at their null unless the log asks for them
    optional: ClassVar[tuple[str, ...]] = ()
    # Values from which those are tried, as in `starts`; without, from their nulls
    tries: ClassVar[tuple[tuple[float, ...], ...]] = ()
    contains: ClassVar[str] = ""  # the effect that this one is where some of its numbers vanish
    counted: ClassVar[bool] = False
    # Its first two numbers are a sine's and a cosine's, its third their spatial period
    periodic: ClassVar[bool] = False
    same_as: ClassVar[str] = ""
    late: ClassVar[bool] = False
    hides_velocity: ClassVar[bool] = False
    # Of the samples: a smaller first number is what integration does, and no effect
    least_periods: ClassVar[float] = 0.0
    # It acts on what drives the joint: at a servo of position on the error, not on the goal
    of_drive: ClassVar[bool] = False
    # Whether the effect grows as its first parameter falls, as a limit's does
    falls: ClassVar[bool] = False

    @staticmethod
    @abstractmethod
    def apply(*arguments: Any) -> Any:
        """The signal after the effect, then the effect's states."""

    @classmethod
    def arguments(cls) -> tuple[str, ...]:
        """Names of what `apply` takes."""
        return _arguments(cls.apply)

    @classmethod
    def delays(cls) -> bool:
        """Whether the effect is a pure transport delay."""
        return "lag_s" in cls.arguments()


ENTRY_POINTS = "trueup.effects"  # the group by which an installed package brings effects
RENAMED = {"zoomed": "grid_refined"}  # attributes that an effect from outside may still have
# of each effect from outside this package the SHA-256 of the file that defines it
_FROM_OUTSIDE: dict[str, str] = {}


def load_effect(file: str | PathLike[str]) -> type[Effect]:
    """The effect that a file of your own defines, which then takes part in every search as those of
    the catalogue do.

    It must be loaded before anything is rolled out, for all effects are compiled together. Raises
    BadEffect.
    """
    path = Path(file)
    if effects.cache_info().currsize:
        raise BadEffect(
            f"{path.name} comes too late: the effects are compiled already",
            hint="Load it first of all, before any case or model.",
        )
    spec = importlib.util.spec_from_file_location(f"trueup_effect_{path.stem}", path)
    if spec is None or spec.loader is None or not path.is_file():
        raise BadEffect(f"{path} is no Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # by which its text is found again
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise BadEffect(f"{path.name} cannot be run: {error!r}") from error
    own = [e for e in Effect.__subclasses__() if e.__module__ == spec.name]
    if len(own) != 1:
        raise BadEffect(f"{path.name} defines {len(own)} effects, one is needed")
    return _admitted(own[0], path)


def _admitted(effect: type[Effect], path: Path) -> type[Effect]:
    """An effect from outside, once it is seen to be whole. Raises BadEffect."""
    name = getattr(effect, "name", "")
    if not NAME.fullmatch(name):
        raise BadEffect(
            f"{path.name}: the name of an effect is words in small letters, not {name!r}"
        )
    for attribute in ("port", "category", "params", "starts"):
        if not hasattr(effect, attribute):
            raise BadEffect(f"{path.name}: the effect {name} declares no {attribute}")
    for old, new in RENAMED.items():
        if hasattr(effect, old):
            raise BadEffect(f"{path.name}: {old} of the effect {name} is now called {new}")
    text = inspect.getdoc(effect) or ""
    for word in ("Equation:", "Source:", "Blind:"):
        if word not in text:
            raise BadEffect(f"{path.name}: the docstring of {name} has no line {word}")
    if {len(s) for s in effect.starts} != {len(effect.params)}:
        raise BadEffect(f"{path.name}: a start of {name} has a value for each of its parameters")
    if not len(effect.states) == len(effect.begins) == len(effect.memory):
        raise BadEffect(f"{path.name}: each state of {name} says where it begins, and its scale")
    if name in _FROM_OUTSIDE:
        raise BadEffect(f"{path.name}: there is an effect {name} already")
    _FROM_OUTSIDE[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return effect


def source_of(effect: str) -> str | None:
    """The SHA-256 of the file of an effect from outside this package, None of one of its own."""
    return _FROM_OUTSIDE.get(effect)


def known_effect(name: str, source: str | None) -> type[Effect]:
    """The effect of this name, if it is the one from a file of this SHA-256, or with None one of
    the catalogue. Raises BadEffect."""
    effect = effects().get(name)
    if effect is None or source_of(name) != source:
        what = f"of a file with the SHA-256 {source}" if source else "of the catalogue"
        raise BadEffect(
            f"the model needs the effect {name} {what}, which is not here",
            hint="Load its file with trueup.load_effect or TRUEUP_EFFECTS, or install what brings "
            "it.",
        )
    return effect


def label_of(effect: str, parameter: str) -> str:
    """What people call a parameter of an effect."""
    labels = {n.name: n.label for n in effects()[effect].params}
    return labels.get(parameter, parameter)


@cache
def effects() -> dict[str, type[Effect]]:
    """Every effect there is, by name, in the order in which they act: those of the catalogue, of
    installed packages, and of files that were loaded."""
    from trueup.model import effects as package  # noqa: PLC0415  (the files import this module)

    for module in pkgutil.iter_modules(package.__path__):
        importlib.import_module(f"{package.__name__}.{module.name}")
    for entry in entry_points(group=ENTRY_POINTS):
        effect = entry.load()
        _admitted(effect, Path(inspect.getfile(effect)))
    ports = list(Port)
    admitted = [
        e
        for e in Effect.__subclasses__()
        if e.__module__.startswith(f"{package.__name__}.") or e.name in _FROM_OUTSIDE
    ]
    ordered = sorted(admitted, key=lambda e: (ports.index(e.port), e.order, e.name))
    by_name = {e.name: e for e in ordered}
    if len(by_name) < len(ordered):
        twice = next(e.name for e in ordered if by_name[e.name] is not e)
        raise BadEffect(f"there is an effect {twice} already", hint="Give yours another name.")
    return by_name
