"""Problem setup: from a plant and its episodes to what is searched.

    Recordings      the plant with its episodes by role, and how they are judged
    Setup           the recordings with the quality of their data and one scheme of integration
    Refitted        the setup's episodes in windows, and the nominal form refitted on them
    SearchProblem   that with everything that a search of terms needs

Each is whole when it exists. A setup says how a problem is made again elsewhere, from the windows'
length and the refitted nominal form.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from trueup.diagnose.candidate import Candidate
from trueup.diagnose.data_quality import DataQuality
from trueup.diagnose.measured_drive import MeasuredDrive, measured_drives
from trueup.diagnose.model_selection import SelectionCriteria, selection_criteria
from trueup.diagnose.search_problem import SearchProblem
from trueup.diagnose.spatial_periods import spatial_periods
from trueup.diagnose.strategy import Strategy, strategy_for
from trueup.diagnose.trimming import Stretch, without
from trueup.diagnose.tuning import SETUP
from trueup.diagnose.windowed_fits import WindowedFits
from trueup.doctor.examine import usable
from trueup.doctor.finding import Finding
from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.errors import NotIdentifiable
from trueup.fit.base_parameters import directions
from trueup.fit.fitter import Fitter
from trueup.fit.identify import identify
from trueup.fit.rollout_fit import RolloutFit
from trueup.model.block import joint, kind, term
from trueup.model.effect import Port, effects
from trueup.model.plant import Plant
from trueup.model.rounding import GUESS_BITS, rounded
from trueup.model.series import Scheme, Series, mergeable, series
from trueup.model.stack import Stack


@dataclass(frozen=True)
class Recordings:
    """A plant with the episodes that are fitted and those that compare, each in the order of their
    digests: however they were handed in, the report is the same. `findings` are what is wrong with
    them; what says nothing is left out of them, and so is what was `put_aside`."""

    plant: Plant
    adaptation: Sequence[Episode]
    validation: Sequence[Episode]
    findings: Sequence[Finding] = ()
    put_aside: Sequence[Stretch] = ()

    @staticmethod
    def of(plant: Plant, episodes: Sequence[Episode]) -> Recordings:
        """The usable part of episodes, by role. Raises NotIdentifiable without a validation
        episode."""
        known = usable(plant, sorted(episodes, key=lambda e: e.digest))
        ordered = sorted(known.episodes, key=lambda e: e.digest)
        adaptation = [e for e in ordered if e.role is Role.ADAPTATION]
        validation = [e for e in ordered if e.role is Role.VALIDATION]
        if not validation:
            raise NotIdentifiable(
                "there is no validation episode to compare on",
                hint="Give at least one episode the role validation.",
            )
        return Recordings(plant, adaptation, validation, known.findings)

    @property
    def declares_stage(self) -> bool:
        """Whether any episode says if a machine or a simulator made it."""
        return any("stage" in e.conditions for e in self.every)

    def as_of_a_machine(self) -> Recordings:
        """These recordings judged as a machine's, whatever they declare."""
        adaptation, validation = (
            [replace(e, conditions={**e.conditions, "stage": "physical"}) for e in episodes]
            for episodes in (self.adaptation, self.validation)
        )
        return replace(self, adaptation=adaptation, validation=validation)

    def without(self, stretches: Sequence[Stretch]) -> Recordings | None:
        """These recordings without some stretches; None where nothing is left to fit, or to compare
        on."""
        adaptation, validation = (
            [part for e in episodes for part in without(e, stretches, SETUP.fewest_samples)]
            for episodes in (self.adaptation, self.validation)
        )
        if not (stretches and adaptation and validation):
            return None
        return replace(
            self, adaptation=adaptation, validation=validation, put_aside=tuple(stretches)
        )

    @property
    def every(self) -> list[Episode]:
        """All of them, those that are fitted first."""
        return [*self.adaptation, *self.validation]

    @cached_property
    def criteria(self) -> SelectionCriteria:
        """How exact a law may be expected to be on these episodes."""
        return selection_criteria(self.plant, self.every)

    @property
    def judged_as(self) -> str:
        """Whose recordings they are taken for."""
        return "machine" if self.criteria.of_machine else "simulator"

    @cached_property
    def strategy(self) -> Strategy:
        """How the plant is diagnosed."""
        return strategy_for(self.plant, self.criteria)

    @cached_property
    def terms(self) -> list[str]:
        """Terms that are found by fitting the plant, but those that a logged effort denies."""
        denied = {t for d in self.drives for t in d.denied}
        terms = searchable([bool(c >= 0) for c in self.plant.command_columns])
        pushes = self.plant.dynamics.takes_force
        return [
            t
            for t in terms
            if t not in denied and (pushes or kind(t).port not in (Port.FORCE, Port.FRICTION))
        ]

    @cached_property
    def drives(self) -> list[MeasuredDrive]:
        """What logged efforts say of the drives."""
        return measured_drives(self.plant, self.every)

    @property
    def window_s(self) -> float:
        """Length of the windows that are fitted [s]: the horizon of evaluation on a machine, whose
        disturbances no model foresees, and of a robot, which soon goes its own way; else some
        seconds at least."""
        horizon_s = self.plant.horizon_s
        if not self.strategy.horizon_windows:
            horizon_s = max(SETUP.window_s, horizon_s)
        return min(horizon_s, *(float(e.t_s[-1]) for e in self.every))


@dataclass(frozen=True)
class Setup:
    """Recordings with the quality of their data, under one scheme of integration."""

    recordings: Recordings
    quality: DataQuality
    scheme: Scheme

    @cached_property
    def episodes(self) -> tuple[Sequence[Episode], Sequence[Episode]]:
        """The episodes that are fitted and those that compare, thinned under a scheme whose steps
        need not be the log's."""
        adaptation, validation = self.recordings.adaptation, self.recordings.validation
        if not self.scheme.alpha:
            return adaptation, validation
        every = self.thinned_by
        return [thinned(e, every) for e in adaptation], [thinned(e, every) for e in validation]

    @property
    def thinned_by(self) -> int:
        """How many samples become one: never where a command is a ramp between them."""
        ramps = self.recordings.plant.ramps(ramped=self.scheme.ramped).any()
        return 1 if ramps else thinning(self.quality, self.recordings.adaptation)

    @cached_property
    def merged(self) -> int:
        """How many declared steps are taken as one, where samples are thinned."""
        return min(self.thinned_by, mergeable(self.recordings.plant)) if self.scheme.alpha else 1

    def refitted(self, parts: int, near: Candidate | None = None) -> Refitted:
        """The nominal form refitted on windows of which so many `parts` make one of full length, or
        more where the nominal form runs away. It is fitted from `near`, the same form fitted under
        another scheme, where that is given."""
        length_s = self.recordings.window_s / parts
        guesses = self._nominal_guesses() if near is None else [self._numbers_of(near)]
        for part_s in length_s / 2.0 ** np.arange(SETUP.halvings + 1):
            fits = self.windowed_fits(float(part_s))
            base = fits.fit_nominal_form(guesses)
            if np.isfinite(base.total):
                break
        return Refitted(self, fits, base)

    def windowed_fits(self, length_s: float) -> WindowedFits:
        """The episodes in windows of a length [s], whose starts are found on whole windows."""
        plant, (adaptation, validation) = self.recordings.plant, self.episodes
        fitter = Fitter(
            plant.form,
            directions(plant, adaptation),
            self.quality.scales,
            self.quality.sigma,
            self.quality.correlation,
            held=self.recordings.strategy.held_starts,
        )
        return WindowedFits(
            fitter,
            self.recordings.strategy,
            Stack.cut(plant, adaptation, self.scheme, length_s, self.merged),
            Stack.cut(plant, validation, self.scheme, length_s, self.merged),
            length_s,
        )

    def _numbers_of(self, candidate: Candidate) -> Sequence[float]:
        """A candidate's parameters of the nominal form."""
        return list(map(float, candidate.fit.values[: len(self.recordings.plant.parameters)]))

    def _nominal_guesses(self) -> list[Sequence[float]]:
        """Parameters from which the nominal form is fitted: the declared ones, and of a robot those
        of a regression."""
        plant = self.recordings.plant
        guesses: list[Sequence[float]] = [plant.parameters]
        if self.recordings.strategy.robot:
            identified, _ = identify(plant, self.episodes[0])
            guesses.append(rounded(np.array(identified.parameters), GUESS_BITS))
        return guesses


@dataclass(frozen=True)
class Refitted:
    """A setup's episodes in windows, and the nominal form refitted on them, `base`."""

    setup: Setup
    fits: WindowedFits
    base: Candidate

    @cached_property
    def problem(self) -> SearchProblem:
        """What is searched, made when it is first asked for."""
        setup, fits, base = self.setup, self.fits, self.base.fit
        plant, (adaptation, validation) = setup.recordings.plant, setup.episodes
        robot = setup.recordings.strategy.robot
        periodic = {
            t: spatial_periods(plant, setup.quality, joint(t), adaptation)
            for t in setup.recordings.terms
            if kind(t).periodic
        }
        short_s, screened = SETUP.screening_window_s, adaptation
        if robot:
            both = [*adaptation, *validation]
            pieces = in_pieces(plant, both, fits.scheme, fits.length_s, setup.merged)
            fits = replace(fits, pieces=pieces)
            fewest_s = SETUP.fewest_samples * max(e.period_s for e in adaptation)
            short_s = min(short_s, max(fits.length_s / SETUP.pieces, fewest_s))
            screened = _screening_episodes(base, adaptation, len(plant.joints))
        else:
            short_s = min(short_s, fits.length_s)
        return SearchProblem(
            fits,
            Stack.cut(plant, screened, fits.scheme, short_s, setup.merged),
            base,
            plant.parameters,
            {t: guesses for t, (guesses, _) in periodic.items()},
            [t for t, (_, part) in periodic.items() if part > SETUP.evident and robot],
        )


def in_pieces(
    plant: Plant, episodes: Sequence[Episode], scheme: Scheme, length_s: float, merged: int = 1
) -> dict[str, Series]:
    """A robot's windows of a length [s] in pieces, in which their starts are found, by episode
    digest; so many declared steps `merged` into one."""
    return {e.digest: series(plant, e, scheme, length_s, SETUP.pieces, merged) for e in episodes}


def searchable(joints: Sequence[bool] = (True,)) -> list[str]:
    """Terms that are found by fitting, of `joints` of which each is driven or not. What acts on a
    whole log acts at the first.

    Of effects that are the same on the log of one joint, both are sought on that of several.
    """
    terms = []
    for j, driven in enumerate(joints):
        for name, effect in effects().items():
            here = (driven or effect.port is not Port.COMMAND) and (
                j == 0 or effect.port is not Port.TIMING
            )
            if here and not effect.counted and not (effect.same_as and len(joints) == 1):
                terms.append(term(name, j))
    return terms


def _screening_episodes(
    base: RolloutFit, episodes: Sequence[Episode], joints: int
) -> list[Episode]:
    """Where terms of a robot are screened: the episodes that the nominal form explains worst, and
    of a long one the stretch that it explains worst."""
    by_episode = base.by_episode
    worst = sorted(episodes, key=lambda e: -by_episode[e.digest])[: SETUP.screening_episodes]
    most = SETUP.screening_rows // (len(worst) * joints)
    costs = base.split(base.costs)
    return [_costliest_stretch(e, costs[e.digest], most) for e in worst]


def _costliest_stretch(episode: Episode, costs: np.ndarray, most: int) -> Episode:
    """No more than so many samples of an episode that follow each other, those whose windows cost
    most `(windows,)`."""
    samples = len(episode.t_s)
    if samples <= most:
        return episode
    many = max(1, int(len(costs) * most / samples))
    first = int(np.argmax(np.convolve(costs, np.ones(many), "valid"))) * samples // len(costs)
    begin = min(first, samples - most)
    return episode.part(begin, begin + most)  # a digest of its own, for hidden states begin there


def thinning(quality: DataQuality, episodes: Sequence[Episode]) -> int:
    """How many samples become one, where there are many and they follow each other much faster than
    the motion."""
    many = sum(len(e.t_s) for e in episodes) // SETUP.enough_samples
    crossing_s = min(s.position / s.velocity for s in quality.scales)
    fast = int(SETUP.finest_step * crossing_s / max(e.period_s for e in episodes))
    return max(1, min(many, fast))


def thinned(episode: Episode, every: int) -> Episode:
    """Each `every`-th sample of an episode, with the mean of the commands in between."""
    if every == 1:
        return episode
    kept = slice(0, len(episode.t_s), every)
    spans = np.diff(episode.t_s, append=2.0 * episode.t_s[-1] - episode.t_s[-2])[:, None]
    starts = np.arange(0, len(episode.t_s), every)
    commands = np.add.reduceat(episode.commands * spans, starts) / np.add.reduceat(spans, starts)
    return replace(
        episode,
        t_s=episode.t_s[kept].copy(),
        commands=commands,
        observations=episode.observations[kept].copy(),
        applied=None,
        effort=None,
    )
