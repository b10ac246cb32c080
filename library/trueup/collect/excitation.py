"""Excitation: the bounded command that serves a goal best and is safe under every model still in
play.

Of many waves and of random excitations, each as large as is safe and ending at rest, the one of
greatest value for the goal is chosen, and then improved. The final one is checked under members
drawn anew, and compared with the random ones, which keep the same bounds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.collect.bounds import Bounds
from trueup.collect.ensemble import Ensemble, InPlay
from trueup.collect.goal import Evaluation, Goal, IdentificationGoal, Run, SplittingGoal
from trueup.collect.wave import AT_REST, LONG, LONGEST, STILL, Held, Maker, Noise, Shape
from trueup.errors import NotIdentifiable
from trueup.model.limits import unsaturated

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]
MEMBERS, JUDGED = 48, 3  # that bound a wave, and that its worth is a mean over
TRIED, IMPROVED = 160, 240  # waves drawn, and changes of the best
# within which time, and to which part of the largest speed, a machine is at rest
SETTLED_S, SETTLED = (60.0, 1e-3)
SMALLEST = 0.01  # of the command's reach: less is no excitation
SHRINK = 0.97
CHECKED = 1000  # members drawn anew, under each of which the final command must hold
DETECTABLE = 4.0  # standard errors between two predictions, over the whole experiment
ALONE = 0.3  # of the effort, to see whether anything parts an alternative
RANDOM = 20  # random excitations to compare with
OF_RANDOM = 200  # members drawn anew, under each of which those are checked


@dataclass(frozen=True)
class Setting:
    """The setting of an excitation: the models in play, its bounds, each observation's noise
    `(observations,)` as a standard deviation, and the state `start` `(2 x joints,)` in which the
    machine rests under the command `hold` `(joints,)`."""

    play: InPlay
    bounds: Bounds
    noise: Array
    start: Array
    hold: Array

    def maker(self, rng: np.random.Generator) -> Maker:
        """A maker of waves that are safe in this setting."""
        return Maker(self.play, self.bounds, self.start, self.hold, self.play.drawn(MEMBERS, rng))


@dataclass(frozen=True, slots=True)
class Compared:
    """Random excitations within the same bounds: their mean value for the goal, how many there are,
    and under how many of them a member leaves the envelope (`breaches`). `unbounded_breaches` says
    the latter of as many random ones that have the energy of the designed one, and no other bound
    than the command's limits: they may tell more, and may not be played.
    """

    information: Evaluation
    count: int
    breaches: int
    unbounded_breaches: int

    def document(self) -> dict[str, Json]:
        """The comparison as JSON."""
        return {
            **self.information.document(),
            "excitations": self.count,
            "breaches": self.breaches,
            "of_same_energy_unbounded": {
                "excitations": RANDOM,
                "breaches": self.unbounded_breaches,
            },
        }


@dataclass(frozen=True)
class Excitation:
    """A designed command `(samples, joints)` at `t_s` [s], from the state `start`, with its
    promised value.

    It begins from rest under the command `hold` `(joints,)`. `paths` `(members, samples, 2 x
    joints)` are the motions under members drawn anew; `central` says where those of each
    composition begin, its central one first. `breaches` is how many leave the envelope, `used` the
    largest part of the envelope that one takes, `rests` whether every one is at rest at the end.
    `information` is the command's value for the goal, `random` that of random excitations within
    the same bounds. `not_identified` says which limits the command does not reach: what is not
    activated is not identified.
    """

    title: str
    t_s: Array
    command: Array
    start: Array
    hold: Array
    information: Evaluation
    random: Compared
    paths: Array
    central: dict[str, int]
    breaches: int
    used: float
    rests: bool
    bounds: Bounds
    not_identified: tuple[str, ...] = ()

    @property
    def speed_at_end(self) -> Array:
        """The largest final speed of each joint under any member, `(joints,)`."""
        return self._speeds(self.paths[:, -1:])

    @property
    def largest_speed(self) -> Array:
        """The largest speed of each joint under any member at any time, `(joints,)`."""
        return self._speeds(self.paths)

    @staticmethod
    def _speeds(paths: Array) -> Array:
        return np.asarray(np.abs(paths[:, :, paths.shape[2] // 2 :]).max(axis=(0, 1)))

    def document(self) -> dict[str, Json]:
        """The excitation as JSON, without the samples."""
        return {
            "samples": len(self.t_s),
            "duration_s": float(self.t_s[-1]),
            "band_hz": list(self.bounds.band_hz),
            "margin": self.bounds.margin,
            "rate": [float(x) for x in self.bounds.rate],
            "members": len(self.paths),
            "breaches": self.breaches,
            "envelope_used": self.used,
            "rests": self.rests,
            "speed_at_end": float(self.speed_at_end.max()),
            "information": self.information.document(),
            "random": self.random.document(),
            "not_identified": list(self.not_identified),
        }


def resting(
    ensemble: Ensemble, bounds: Bounds, candidates: Sequence[tuple[Array, Array]]
) -> tuple[Array, Array]:
    """The command to hold and the rest to begin from. Of `candidates`, each a command to hold
    `(joints,)` and a state to seek rest from `(2 x joints,)`, it is the one whose rest has the most
    room within the envelope.

    Raises NotIdentifiable where the machine comes to rest under none of them, or under none inside
    the envelope.
    """
    best: tuple[float, Array, Array] | None = None
    refused: NotIdentifiable | None = None
    for hold, begin in candidates:
        try:
            rest = at_rest(ensemble, begin, hold)
        except NotIdentifiable as moving:
            refused = moving
            continue
        room = bounds.room(rest)
        if best is None or room > best[0]:
            best = room, hold, rest
    if best is None:
        assert refused is not None
        raise refused
    if best[0] <= 0.0:
        where = ", ".join(f"{x:.4g}" for x in best[2][: len(best[1])])
        raise NotIdentifiable(
            f"the machine comes to rest at {where}, outside of the envelope less its margin",
            hint=(
                "Widen the envelope, or put a recording into the case folder that begins at "
                "rest inside of it."
            ),
        )
    return best[1], best[2]


def at_rest(ensemble: Ensemble, start: Array, hold: Array) -> Array:
    """The state `(2 x joints,)` in which the central model stays under the command `hold`, sought
    from `start`.

    Raises NotIdentifiable where it never comes to rest: such a machine must be held by a controller
    while it is excited.
    """
    plant = ensemble.plant
    t_s = np.asarray(np.arange(round(SETTLED_S / plant.timestep_s)) * plant.timestep_s, np.float64)
    path = ensemble.responses(ensemble.centre[:, None], t_s, np.tile(hold, (len(t_s), 1)), start)[0]
    joints = len(hold)
    speed = np.abs(path[:, joints:])
    if not np.isfinite(path).all() or speed[-1].max() > SETTLED * max(float(speed.max()), SETTLED):
        raise NotIdentifiable(
            "under a constant command the machine does not come to rest",
            hint=(
                "Excite it through its controller: describe the loop as a position servo, "
                "or add the wave to a trajectory."
            ),
        )
    return np.concatenate([path[-1, :joints], np.zeros(joints)])


def identification(
    setting: Setting,
    rng: np.random.Generator,
    progress: Progress = lambda _stage, _part: None,
    effort: float = 1.0,
) -> Excitation:
    """The excitation that determines the numbers of the first ensemble best; `effort` scales how
    many waves are tried. Raises NotIdentifiable where no wave is safe."""
    maker = setting.maker(rng)
    random = Random.drawn(maker, rng)
    goal = IdentificationGoal.of(
        setting.play.ensembles[0],
        setting.noise,
        setting.start,
        maker.members[0][:, :JUDGED],
        random.runs,
    )
    _, wave = _best(maker, goal, rng, progress, effort, random.shapes)
    return _checked(maker, goal, wave, random, rng, progress)


def splitting(
    setting: Setting,
    rng: np.random.Generator,
    progress: Progress = lambda _stage, _part: None,
    effort: float = 1.0,
) -> Excitation:
    """The excitation that separates the first ensemble from each of the others, whichever is right.

    An alternative that no command separates by DETECTABLE standard errors is reported, and does not
    keep the others from being separated. Raises NotIdentifiable where no wave is safe.
    """
    maker, every = (
        setting.maker(rng),
        SplittingGoal(setting.play.ensembles, setting.noise, setting.start),
    )
    least, wave = _best(maker, every, rng, progress, effort)
    random = Random.drawn(maker, rng)
    answer, *others = setting.play.ensembles
    if least < np.log(DETECTABLE) and len(others) > 1:
        alone = [
            (
                e,
                _best(maker, replace(every, ensembles=(answer, e)), rng, progress, ALONE * effort)[
                    0
                ],
            )
            for e in others
        ]
        parted = [e for e, value in alone if value >= np.log(DETECTABLE)]
        if 0 < len(parted) < len(others):
            wave = _best(maker, replace(every, ensembles=(answer, *parted)), rng, progress, effort)[
                1
            ]
    return _checked(maker, every, wave, random, rng, progress)


@dataclass(frozen=True, slots=True)
class Random:
    """Random excitations that are as large as is safe, and end at rest: their `shapes`, and their
    `runs`."""

    shapes: tuple[Noise, ...]
    runs: tuple[Run, ...]

    @staticmethod
    def drawn(maker: Maker, rng: np.random.Generator) -> Random:
        """RANDOM of them; fewer where some are not safe at any size."""
        pairs = [(shape, maker.made(shape)) for shape in (maker.noise(rng) for _ in range(RANDOM))]
        safe = [(shape, made) for shape, made in pairs if made is not None]
        return Random(tuple(shape for shape, _ in safe), tuple((t, u) for _, (t, u, _size) in safe))

    def compared(self, maker: Maker, goal: Goal, to: Run, rng: np.random.Generator) -> Compared:
        """Their value for a goal, and how many let a member that is drawn anew leave the envelope,
        beside unbounded ones of the energy of the command that they are compared `to`."""
        fresh, bounds = maker.play.drawn(OF_RANDOM, rng), maker.bounds
        low, high = bounds.whole().T

        def leaves(run: Run) -> bool:
            paths = maker.play.responses(fresh, *run, maker.start)
            return not bool(((paths >= low) & (paths <= high)).all())

        unbounded = [(to[0], bounds.random(maker.hold, to[1], rng)) for _ in range(RANDOM)]
        left, free = (sum(map(leaves, runs)) for runs in (self.runs, unbounded))
        return Compared(goal.evaluate(self.runs), len(self.runs), left, free)


def _best(
    maker: Maker,
    goal: Goal,
    rng: np.random.Generator,
    progress: Progress,
    effort: float,
    others: Sequence[Shape] = (),
) -> tuple[float, Shape]:
    """The value of the best shape for a goal, and the shape: of waves, and of `others`. Raises
    NotIdentifiable where none is safe or has any value."""
    best: tuple[float, Shape] | None = None
    tried, improved = max(1, round(effort * TRIED)), round(effort * IMPROVED)
    drawn = [*others, *(maker.draw(rng) for _ in range(tried))]
    for i, wave in enumerate(drawn):
        value = _worth(maker, goal, wave, best[0] if best else -np.inf)
        if best is None or value > best[0]:
            best = value, wave
        progress("drawing waves", (i + 1) / len(drawn))
    assert best is not None
    for i in range(improved):
        wave = best[1].changed(rng, 0.5 * (1.0 - i / improved) + 0.05)
        value = _worth(maker, goal, wave, best[0])
        best = (value, wave) if value > best[0] else best
        progress("improving the best", (i + 1) / improved)
    if best[0] == -np.inf:
        raise NotIdentifiable(
            "no excitation within the bounds tells the numbers apart",
            hint=(
                "Allow a longer duration, a wider band or envelope, or leave out numbers "
                "that this machine cannot show."
            ),
        )
    return best


def _worth(maker: Maker, goal: Goal, wave: Shape, above: float) -> float:
    made = maker.made(wave)
    return -np.inf if made is None else goal.value(made[0], made[1], above)


def _checked(
    maker: Maker,
    goal: Goal,
    wave: Shape,
    others: Random,
    rng: np.random.Generator,
    progress: Progress,
) -> Excitation:
    """The wave as an excitation, made a little smaller until none of CHECKED members drawn anew
    breaches the envelope's margin. Those get as long a hold as they need to come to rest, if there
    is one."""
    made = maker.made(wave)
    assert made is not None
    size, fresh = made[2], maker.play.drawn(CHECKED, rng)
    while not (held := _held(maker, maker.sized(wave, size), fresh)).safe:
        size *= max(0.5, min(SHRINK, 1.0 / held.used))
        if size < SMALLEST:
            raise NotIdentifiable(
                "a model still in play leaves the envelope under the smallest excitation",
                hint=(
                    "Narrow the spread of the numbers, widen the envelope, or hold the "
                    "machine where there is room."
                ),
            )
        progress("checking on members drawn anew", 0.5)
    low, high = maker.bounds.whole().T
    outside = ~((held.paths >= low) & (held.paths <= high)).all(axis=(1, 2))
    bounded = np.isfinite(low)
    middle, half = (high[bounded] + low[bounded]) / 2.0, (high[bounded] - low[bounded]) / 2.0
    used = float((np.abs(held.paths[:, :, bounded] - middle) / half).max())
    progress("comparing with random ones", 0.9)
    final, plant = (held.t_s, held.command), maker.play.ensembles[0].plant
    commands = plant.layout.commands
    information = goal.evaluate([final])
    random = others.compared(maker, goal, final, rng)
    begins = np.cumsum([0, *(m.shape[1] for m in fresh)])
    central = {
        " + ".join(e.effects) or "no effect": int(first)
        for e, first in zip(maker.play.ensembles, begins, strict=False)
    }
    return Excitation(
        title=goal.title,
        t_s=held.t_s,
        command=held.command,
        start=maker.start,
        hold=maker.hold,
        information=information,
        random=random,
        paths=held.paths,
        central=central,
        breaches=int(outside.sum()),
        used=used,
        rests=held.rests,
        bounds=maker.bounds,
        not_identified=unsaturated(plant, held.command[:, [plant.joint_of(c) for c in commands]]),
    )


def _held(maker: Maker, sized: Held, members: tuple[Array, ...]) -> Held:
    """A command with a hold that brings these members to a standstill, else with one that brings
    them to rest, else the longest."""
    for rest, longest in ((STILL, LONG), (AT_REST, LONGEST)):
        held = maker.held(sized.t_s, sized.command, members, rest, longest)
        if held.rests or not held.safe:
            break
    return held
