"""Safeguards: what was meant to keep a collection safe, in a form that the recording can be held
against.

An episode's metadata say under `safeguards`, as JSON text:

    [{"signal": "q", "low": -0.8, "high": 0.8, "enforced_by": "limit switches",
      "independent_of": "the controller"}]

and under `stop_criterion` one such object, with `within_s`, the time [s] in which the run stops
once the signal is beyond its bounds:

    {"signal": "q", "high": 0.9, "enforced_by": "emergency stop", "independent_of": "the computer",
     "within_s": 0.2}

A signal is an observation or a command of the plant. Every bound needs who enforces it, and of what
that is independent: a safeguard that fails with what it guards against is none. Free text is kept,
and cannot be checked.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.collect.required import SAFEGUARDS
from trueup.episode.episode import Episode
from trueup.errors import BadPlant
from trueup.model.fields import Reader
from trueup.model.plant import Plant
from trueup.model.state import smoothed_states

Array = NDArray[np.float64]
STOP = "stop_criterion"
FIELDS = ("signal", "low", "high", "enforced_by", "independent_of")
STOPPED = 0.02  # of the largest recorded speed: slower is at a stop
MOST = 64  # safeguards of an episode


@dataclass(frozen=True, slots=True)
class Safeguard:
    """A bound on a signal: who enforces it, and of what that is independent. `within_s` [s] is how
    soon the run stops beyond it, None where it is to be kept and not to stop the run."""

    signal: str
    low: float | None
    high: float | None
    enforced_by: str
    independent_of: str
    within_s: float | None = None

    @staticmethod
    def read(reader: Reader, *, stops: bool) -> Safeguard:
        """The bound that a document describes. Raises BadPlant at its field."""
        reader.no_more(*FIELDS, *(("within_s",) if stops else ()))
        low, high = (reader.number(end) if end in reader.value else None for end in ("low", "high"))
        if low is None and high is None:
            raise BadPlant(f"{reader.path or 'a bound'} needs low or high", field=reader.path)
        return Safeguard(
            reader.text("signal"),
            low,
            high,
            reader.text("enforced_by"),
            reader.text("independent_of"),
            reader.number("within_s", above=0.0) if stops else None,
        )

    def beyond(self, values: Array) -> NDArray[np.bool_]:
        """Which values `(samples,)` are beyond the bound; nan is not."""
        low, high = (
            -np.inf if self.low is None else self.low,
            np.inf if self.high is None else self.high,
        )
        return np.asarray((values < low) | (values > high))

    @property
    def words(self) -> str:
        """The bound in words."""
        if self.low is None or self.high is None:
            word, end = ("above", self.low) if self.high is None else ("below", self.high)
            return f"{self.signal} stays {word} {end:g}"
        return f"{self.signal} stays within [{self.low:g}, {self.high:g}]"

    def document(self) -> dict[str, Json]:
        """The bound as JSON."""
        fields: dict[str, Json] = {
            "signal": self.signal,
            "low": self.low,
            "high": self.high,
            "enforced_by": self.enforced_by,
            "independent_of": self.independent_of,
        }
        return fields if self.within_s is None else {**fields, "within_s": self.within_s}


def held_against(plant: Plant, episode: Episode, warnings: list[str]) -> dict[str, Json]:
    """What a recording says of its declared safeguards: of each whether the bound was met, and of
    the stop criterion whether it was reached and the run then stopped; `checked` says whether both
    were declared so that they could be checked, `held` whether they then held."""
    guards = _read(episode.conditions.get(SAFEGUARDS), SAFEGUARDS, warnings)
    stops = _read(episode.conditions.get(STOP), STOP, warnings)
    if guards is None and stops is None:
        return {"checked": False, "held": None, SAFEGUARDS: [], STOP: None}
    kept = [_bound(plant, episode, g, warnings) for g in guards or ()]
    stop = None if not stops else _stop(plant, episode, stops[0], warnings)
    checked = bool(kept) and stop is not None
    verdicts = [k["met"] for k in kept] + ([stop["held"]] if stop else [])
    held = None if not checked or None in verdicts else all(verdicts)
    return {"checked": checked, "held": held, SAFEGUARDS: list(kept), STOP: stop}


def _read(text: str | None, name: str, warnings: list[str]) -> list[Safeguard] | None:
    """The bounds that a condition declares; None where it is missing, free text, or says nothing
    that can be checked."""
    if text is None:
        return None
    if not text.lstrip().startswith(("[", "{")):
        return None
    try:
        given = orjson.loads(text)
        entries = given if isinstance(given, list) else [given]
        if not 0 < len(entries) <= MOST or (name == STOP and len(entries) != 1):
            raise ValueError(f"it holds {len(entries)} entries")
        return [
            Safeguard.read(Reader.of(entry, f"{name}[{i}]"), stops=name == STOP)
            for i, entry in enumerate(entries)
        ]
    except (ValueError, BadPlant) as error:
        said = error.message if isinstance(error, BadPlant) else str(error)
        warnings.append(f"the {name.replace('_', ' ')} cannot be checked: {said}")
        return None


def _values(plant: Plant, episode: Episode, signal: str) -> Array | None:
    """The recorded values of a signal `(samples,)`; None where there is no such signal, or the log
    lacks it."""
    columns = {
        **dict(
            zip((c.name for c in plant.layout.observations), episode.observations.T, strict=True)
        ),
        **dict(zip((c.name for c in plant.layout.commands), episode.commands.T, strict=True)),
    }
    values = columns.get(signal)
    return None if values is None or np.isnan(values).all() else values


def _bound(plant: Plant, episode: Episode, guard: Safeguard, warnings: list[str]) -> dict[str, Any]:
    values = _values(plant, episode, guard.signal)
    if values is None:
        warnings.append(f"a safeguard names {guard.signal!r}, which is not in the recording")
        return {**guard.document(), "met": None}
    beyond = np.flatnonzero(guard.beyond(values))
    if not len(beyond):
        return {**guard.document(), "met": True}
    first = float(episode.t_s[beyond[0]])
    warnings.append(
        f"a safeguard did not hold: {guard.words}, enforced by {guard.enforced_by}, was broken in "
        f"{len(beyond)} samples, first at {first:.3g} s"
    )
    return {**guard.document(), "met": False, "samples": len(beyond), "first_s": first}


def _stop(plant: Plant, episode: Episode, stop: Safeguard, warnings: list[str]) -> dict[str, Any]:
    """Whether the run stopped once the criterion was reached: the recording ends within the time,
    or nothing moves from then on."""
    values = _values(plant, episode, stop.signal)
    if values is None or stop.within_s is None:
        warnings.append(f"the stop criterion names {stop.signal!r}, which is not in the recording")
        return {**stop.document(), "reached": None, "held": None}
    beyond = np.flatnonzero(stop.beyond(values))
    if not len(beyond):
        return {**stop.document(), "reached": False, "held": True}
    reached = float(episode.t_s[beyond[0]])
    moving = episode.t_s[_moving(plant, episode)]
    last = float(moving[-1]) if len(moving) else reached
    held = last <= reached + stop.within_s
    if not held:
        warnings.append(
            f"the run did not stop where it said: {stop.signal} reached the stop criterion at "
            f"{reached:.3g} s, and the machine still moved at {last:.3g} s"
        )
    return {
        **stop.document(),
        "reached": True,
        "held": held,
        "reached_s": reached,
        "moved_until_s": last,
    }


def _moving(plant: Plant, episode: Episode) -> NDArray[np.bool_]:
    """The samples at which any joint moves, `(samples,)`."""
    speeds = np.nan_to_num(np.abs(smoothed_states(plant, episode)[:, len(plant.joints) :]))
    return np.asarray((speeds > STOPPED * speeds.max(axis=0)).any(axis=1))
