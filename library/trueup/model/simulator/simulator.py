"""Simulator: a model of the user's own, any function that moves a state on by one step.

    step(state, command, parameters) -> state

`state` `(lanes, 2 x joints + hidden)` holds the positions, the velocities and whatever else the
simulator remembers; `command` `(lanes, joints)`; `parameters` a dict of arrays `(lanes,)`. Every
lane is a simulation of its own. A function that also takes `force` `(lanes, joints)`, a force at
each joint in the simulator's own unit, lets effects act that push or hold: friction, backlash's
rebound, cogging.
One that takes `h_s`, the length of the step [s] `(lanes,)`, is asked for other steps than its
declared one; of others a part of the step is taken in proportion.

It is named in a model by the SHA-256 of its text, and a model loads only where that is at hand.
"""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.errors import BadSimulator

Array = NDArray[np.float64]
Step = Callable[..., Any]
LANES = 3  # that a simulator is tried with
SAME = 1e-9  # of a state: lanes of one simulator that differ by more disturb each other
NAMES = ("state", "command", "parameters", "force", "h_s")


@dataclass(frozen=True, eq=False)
class Simulator:
    """A user's step function. `parameters` are its numbers and what they are in the nominal model,
    `timestep_s` [s] the length of its step, `begins` the values with which hidden states begin,
    `names` those of several joints, in the order of a state; `sha256` names its text."""

    name: str
    step: Step
    parameters: Mapping[str, float]
    timestep_s: float
    begins: tuple[float, ...] = ()
    sha256: str = ""
    names: tuple[str | None, ...] = (None,)

    @cached_property
    def joints(self) -> int:
        """How many joints it moves."""
        return len(self.names)

    @cached_property
    def motion(self) -> int:
        """How many columns of a state are positions and velocities."""
        return 2 * self.joints

    @cached_property
    def takes_force(self) -> bool:
        """Whether forces can be added to the joints."""
        return "force" in _arguments(self.step)

    @cached_property
    def takes_step(self) -> bool:
        """Whether it can make steps of any length."""
        return "h_s" in _arguments(self.step)

    def moved(
        self,
        state: Array,
        command: Array,
        parameters: Mapping[str, Array],
        h_s: Array | None = None,
        force: Array | None = None,
    ) -> Array:
        """States `(lanes, states)` after a step of the declared length, or of `h_s` [s]
        `(lanes,)`, under commands and forces `(lanes, joints)`. Raises BadSimulator."""
        more: dict[str, Any] = {}
        if self.takes_force:
            more["force"] = np.zeros(command.shape) if force is None else force
        if self.takes_step:
            more["h_s"] = np.full(len(state), self.timestep_s) if h_s is None else h_s
        try:
            after = np.asarray(self.step(state, command, parameters, **more), float)
        except Exception as error:
            raise BadSimulator(
                f"the step of {self.name} failed: {error!r}",
                hint="It gets arrays of many simulations: np.sin, not math.sin. " + self._columns(),
            ) from error
        if after.shape != state.shape:
            raise BadSimulator(
                f"the step of {self.name} returned {after.shape} for states {state.shape}",
                hint="Return the states after the step, a row for each lane, as they came. "
                + self._columns(),
            )
        if h_s is None or self.takes_step or bool((h_s == self.timestep_s).all()):
            return after
        return np.asarray(state + (h_s / self.timestep_s)[:, None] * (after - state))

    def _columns(self) -> str:
        """What stands in the columns of a state and of commands, in words."""
        if self.joints == 1:
            return (
                "state[:, 0] is the position, state[:, 1] the velocity, command[:, 0] the command."
            )
        return (
            f"state[:, :{self.joints}] are the positions of the joints, "
            f"state[:, {self.joints}:{self.motion}] their velocities, command[:, 0] the command of "
            "the first."
        )

    def checked(self) -> Simulator:
        """This simulator, once it is seen to do what the search relies on. Raises BadSimulator."""
        if not self.parameters:
            raise BadSimulator(f"{self.name} declares no parameter", hint="Name what may be off.")
        if not self.timestep_s > 0.0:
            raise BadSimulator(f"the step of {self.name} has no length", field="timestep_s")
        rng = np.random.default_rng(1)
        states = rng.normal(size=(LANES, self.motion + len(self.begins)))
        states[:, self.motion :] = self.begins
        commands = rng.normal(size=(LANES, self.joints))
        together = self.moved(states, commands, self._lanes(LANES))
        again = self.moved(states, commands, self._lanes(LANES))
        alone = np.concatenate(
            [self.moved(states[i : i + 1], commands[i : i + 1], self._lanes(1)) for i in range(3)]
        )
        if not np.isfinite(together).all():
            raise BadSimulator(f"{self.name} gives no finite state from {states[0].tolist()}")
        for other, what in ((again, "a second call gives"), (alone, "a lane alone gives")):
            if not np.allclose(together, other, rtol=SAME, atol=SAME):
                raise BadSimulator(
                    f"{what} another state than lanes together: {self.name} keeps something "
                    "from call to call, or mixes its lanes",
                    hint="Put what it remembers in the state, as hidden states.",
                )
        return self

    def _lanes(self, count: int) -> dict[str, Array]:
        return {name: np.full(count, value) for name, value in self.parameters.items()}


_AT_HAND: dict[str, Step] = {}
_NAMED: dict[str, str] = {}  # the SHA-256 of each loaded file by the file's name


def offer(step: Step) -> str:
    """Keep a step function at hand, and return the SHA-256 of its text. Raises BadSimulator."""
    unknown = [n for n in _arguments(step) if n not in NAMES and n not in _defaults(step)]
    if unknown or _arguments(step)[:3] != NAMES[:3]:
        raise BadSimulator(
            "a step takes state, command and parameters, by these names, and may take force and "
            f"h_s; this one takes {', '.join(_arguments(step))}"
        )
    digest = hashlib.sha256(_text(step)).hexdigest()
    _AT_HAND[digest] = step
    return digest


def load_simulator(file: str | PathLike[str]) -> str:
    """Keep the simulator of a file at hand: a Python file that defines `step`, or an ONNX
    model. Returns the file's SHA-256. Raises BadSimulator, NotInstalled."""
    path = Path(file)
    if not path.is_file():
        raise BadSimulator(f"there is no file {path}")
    step = _onnx(path) if path.suffix == ".onnx" else _python(path)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    _AT_HAND[digest], _NAMED[path.name] = step, digest
    return digest


def step_at_hand(sha256: str, name: str) -> Step:
    """The step function of this digest. Raises BadSimulator where it is not at hand."""
    if sha256 not in _AT_HAND:
        raise BadSimulator(
            f"the model needs the simulator {name}"
            + (f" with the SHA-256 {sha256[:12]}…" if sha256 else "")
            + ", which is not here",
            hint="Load its file with trueup.load_simulator or TRUEUP_SIMULATORS. A function of a "
            "notebook is there once its case is made; for commands, keep it in a file and name "
            "that: trueup.Simulator('FILE.py', ...).",
        )
    return _AT_HAND[sha256]


def takes_step(sha256: str) -> bool:
    """Whether a step function at hand makes steps of any length."""
    return "h_s" in _arguments(_AT_HAND[sha256])


def digest_of_file(name: str) -> str | None:
    """The SHA-256 of a loaded file of this name, None where none was loaded."""
    return _NAMED.get(name)


def _onnx(path: Path) -> Step:
    from trueup.model.simulator.onnx_step import OnnxStep  # noqa: PLC0415  (optional)

    return OnnxStep.read(path)


def _python(path: Path) -> Step:
    spec = importlib.util.spec_from_file_location(f"trueup_simulator_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise BadSimulator(
            f"{path.name} is no simulator",
            hint="Hand in a Python file that defines step(), or an ONNX model.",
        )
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise BadSimulator(f"{path.name} cannot be run: {error!r}") from error
    step = getattr(module, "step", None)
    if not callable(step):
        raise BadSimulator(f"{path.name} defines no function step")
    offer(step)
    return step  # type: ignore[no-any-return]


def _arguments(step: Step) -> tuple[str, ...]:
    return tuple(inspect.signature(step).parameters)


def _defaults(step: Step) -> set[str]:
    return {n for n, p in inspect.signature(step).parameters.items() if p.default is not p.empty}


def _text(step: Step) -> bytes:
    """The text of a function with what it closes over, or of the class of what can be called; its
    compiled code where nobody kept the text. Raises BadSimulator."""
    of = step if inspect.isfunction(step) or inspect.ismethod(step) else type(step)
    cells = getattr(of, "__closure__", None) or ()
    closed_over = [_told(cell.cell_contents) for cell in cells]
    try:
        return b"\n".join([inspect.getsource(of).encode(), *closed_over])
    except (OSError, TypeError) as error:
        code = getattr(of, "__code__", None)
        if code is None:
            raise BadSimulator(
                "the text of the step function is not known, by which a model names it",
                hint="Define it in a file, or in a notebook's cell.",
            ) from error
        return b"\n".join([code.co_code, repr(code.co_names).encode(), *closed_over])


def _told(value: Any) -> bytes:
    """What a function closes over: the text of a function, plain data, the class of all else."""
    if inspect.isfunction(value):
        return _text(value)
    if isinstance(value, np.ndarray):
        return value.tobytes()
    plain = isinstance(value, bool | int | float | str | bytes | tuple | list | dict)
    return repr(value if plain else type(value)).encode()
