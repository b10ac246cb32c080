"""Design: the next experiment for a plant, by what was recorded of it and what a diagnosis left."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.collect.bounds import Bounds, Recorded
from trueup.collect.checklist import checks
from trueup.collect.ensemble import Ensemble, InPlay
from trueup.collect.excitation import (
    DETECTABLE,
    Excitation,
    Setting,
    identification,
    resting,
    splitting,
)
from trueup.collect.goal import Separation
from trueup.diagnose.data_quality import assess
from trueup.diagnose.indistinguishable import how_to_part
from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.errors import NotIdentifiable
from trueup.model.corrected import Corrected
from trueup.model.plant import Plant
from trueup.model.state import smoothed_states

Array = NDArray[np.float64]
ELSEWHERE = "add another sensor at the joint, or another load"
QUIET = 1e-3  # share of the reporting scale: the noise assumed without a recording
SCHEMA = "trueup.excitation/1"
SPREAD = 0.3  # relative 95 % interval of declared numbers that nothing says anything of
Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True)
class Allowed:
    """What an excitation may do: its duration [s] without the hold at its end, its band [Hz], the
    largest change of a command and the largest speed of a joint a second, and the share of the
    envelope that is kept free. None is as recorded, or told by duration and step."""

    duration_s: float = 12.0
    band_hz: tuple[float, float] | None = None
    rate: float | None = None
    speed: float | None = None
    margin: float = 0.1


@dataclass(frozen=True)
class Design:
    """An excitation, the models under all of which it is safe, what to check before it is played,
    and all of it as a document. `not_parted` says what would separate each alternative that it does
    not."""

    plant: Plant
    excitation: Excitation
    play: InPlay
    check_first: list[str]
    document: Mapping[str, Json]
    not_parted: tuple[str, ...]


def design(
    plant: Plant,
    episodes: Sequence[Episode],
    allowed: Allowed,
    *,
    diagnosed: tuple[Corrected, Mapping[str, Any]] | None = None,
    spread: float = SPREAD,
    split: bool = False,
    seed: int = 0,
    progress: Progress = lambda _stage, _part: None,
) -> Design:
    """Design an excitation that identifies the plant's numbers, or with `split` one that separates
    the explanations that a diagnosis left.

    `diagnosed` is a corrected model with its report; without one, `spread` is the relative 95 %
    interval of each nominal number. Raises NotIdentifiable where no command within the bounds does
    it, BadPlant for an envelope of what is not observed.
    """
    plant.require_known_envelope()
    used = [e for e in episodes if e.role is Role.ADAPTATION]
    report: Mapping[str, Any] = diagnosed[1] if diagnosed else {}
    play = InPlay((Ensemble.prior(plant, spread),))
    if diagnosed is not None:
        answer = Ensemble.posterior(*diagnosed)
        play = InPlay((answer, *Ensemble.alternatives(diagnosed[0].plant, report)))
    if split and len(play.ensembles) == 1:
        raise _nothing_to_split(report)
    bounds = Bounds.of(
        plant,
        allowed.duration_s,
        allowed.band_hz,
        allowed.rate,
        allowed.margin,
        speed=allowed.speed,
        recorded=Recorded.of(plant, used),
    )
    hold, rest = resting(play.ensembles[0], bounds, _candidates(plant, used, bounds))
    setting = Setting(play, bounds, _noise(plant, used, report), rest, hold)
    act = splitting if split else identification
    excitation = act(setting, np.random.default_rng(seed), progress)
    information = excitation.information
    not_parted = _otherwise(play, information) if isinstance(information, Separation) else ()
    if isinstance(information, Separation) and max(information.standard_errors) < DETECTABLE:
        raise NotIdentifiable(
            "no command that was tried within the bounds parts the alternatives by "
            f"{DETECTABLE:g} standard errors, at best "
            f"{max(information.standard_errors):.1f}",
            hint="; or ".join(not_parted)
            + "; or allow a longer duration, a wider band or envelope.",
        )
    first = checks(plant, excitation, diagnosed=diagnosed is not None)
    document: dict[str, Json] = {
        "check_first": list(first),
        "schema": SCHEMA,
        "plant": plant.name,
        "goal": "split" if split else "identify",
        "seed": seed,
        **excitation.document(),
    }
    return Design(plant, excitation, play, first, document, tuple(not_parted))


def _otherwise(play: InPlay, separation: Separation) -> list[str]:
    """What would separate each alternative that the experiment does not."""
    answer, *others = (e.hypothesis for e in play.ensembles)
    apart = zip(others, separation.alternatives, separation.standard_errors, strict=True)
    short = [(other, " + ".join(names)) for other, names, x in apart if x < DETECTABLE]
    return [f"for {names}, {how_to_part(answer, other) or ELSEWHERE}" for other, names in short]


def _nothing_to_split(report: Mapping[str, Any]) -> NotIdentifiable:
    if not report:
        return NotIdentifiable(
            "there are no alternatives to split without a diagnosis",
            hint="Give its folder with --model.",
        )
    why = (report.get("next_experiment") or {}).get("why")
    if report["indistinguishable"] and "alternatives" not in report["evidence"]:
        why = "Its report does not keep the alternatives as they were fitted: diagnose again."
    return NotIdentifiable(
        "the diagnosis left no alternatives that a command could split",
        hint=why or "Its answer is unique: leave out --split to sharpen its numbers.",
    )


def _candidates(
    plant: Plant, episodes: Sequence[Episode], bounds: Bounds
) -> list[tuple[Array, Array]]:
    """Pairs of a command to hold and a state from which to seek rest.

    For one joint it is no command in the middle of the envelope. Each recording adds its first and
    its mean command and state. A robot's rest is unknown without a recording, because its commands
    hold it against its weight. Raises NotIdentifiable if there is no pair.
    """
    joints = len(plant.joints)
    middle = np.concatenate([bounds.envelope[:joints].mean(axis=1), np.zeros(joints)])
    none = np.clip(np.zeros(joints), bounds.low, bounds.high)
    pairs = [(none, middle)] if joints == 1 else []
    for episode in episodes[:1]:
        states = np.nan_to_num(smoothed_states(plant, episode))
        commands = plant.applied(episode.commands)
        states[:, joints:] = 0.0
        pairs += [(commands[0], states[0]), (commands.mean(axis=0), states.mean(axis=0))]
    if not pairs:
        raise NotIdentifiable(
            "a robot's rest is not known without a recording",
            hint="Put an adaptation episode that begins at rest into the case folder.",
        )
    return pairs


def _noise(plant: Plant, episodes: Sequence[Episode], report: Mapping[str, Any]) -> Array:
    """The noise of each observation `(observations,)`.

    It is the diagnosis's estimate, enlarged by the root of its reduced chi-square; else as
    recorded, or QUIET.
    """
    quiet = QUIET * plant.scales
    if report:
        noise = np.array(
            [report["evidence"]["noise"][c.name] for c in plant.layout.observations], float
        )
        factor = np.sqrt(max(report["evidence"].get("misfit") or 1.0, 1.0))
        return np.asarray(factor * np.where(np.isfinite(noise) & (noise > 0.0), noise, quiet))
    if not episodes:
        return quiet
    measured = assess(plant, episodes).noise[plant.state_columns]
    return np.where(np.isfinite(measured) & (measured > 0.0), measured, quiet)
