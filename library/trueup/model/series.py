"""Series: an episode laid out for compiled rollouts, cut into windows whose starts are estimated.

Positions and velocities are compared where they were observed; a sample that repeats the one before
it (a held frame), or that has no number, is left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trueup.episode.episode import Episode
from trueup.model.plant import Plant
from trueup.model.state import known_from, smoothed_states
from trueup.model.windows import intervals, starts_every

Array = NDArray[np.float64]
DISTINCT = 0.9  # of the samples have a value of their own where noise is finer than no lattice
FINE_S = 0.0125  # there the error of a 1 Hz motion is 3e-4
FINE_RAD = 0.25  # of an oscillation: there the error of its frequency is 3e-3
MOST_PARTS = 4  # of a declared step: a faster oscillation is not seen at that rate
NEAR_S = 1e-6  # a step in which no mode turns by more than a small angle
# times the step after it: the one that follows a lost frame, which a joint that stuck does not make
CATCHES_UP = 1.5
MOSTLY = 0.4  # of the short runs
STEPS = 2.0  # of the sensor, by which a joint must have moved for a repeated value to be a lost one
ROUNDING = 1e-9  # of the range: closer values are one value
OFF_LATTICE, ON_LATTICE = 0.1, 0.95  # of a step, for so many of the differences
AT_REST = 6  # equal positions in a row are a joint at rest, not frames lost one after another


@dataclass(frozen=True, slots=True)
class Scheme:
    """How the dynamics are integrated: the declared step, or its symmetric form on `parts` of it;
    and whether commands whose hold nobody declared are ramps between their samples."""

    alpha: float
    parts: int
    ramped: bool = False


DECLARED = Scheme(0.0, 1)


def refined(plant: Plant) -> Scheme:
    """The symmetric scheme, on parts of the declared step no longer than FINE_S, and short against
    the nominal model's fastest oscillation; a simulator's own steps are its own."""
    if plant.form.simulator is not None:
        return Scheme(0.5, 1)
    by_mode = min(np.ceil(plant.timestep_s * _fastest(plant) / FINE_RAD - 1e-9), MOST_PARTS)
    return Scheme(0.5, int(max(1, np.ceil(plant.timestep_s / FINE_S - 1e-9), by_mode)))


def on_finer_steps(plant: Plant, scheme: Scheme, times: int) -> Scheme:
    """A scheme with steps so many `times` finer; a simulator's own steps are its own."""
    if plant.form.simulator is not None:
        return scheme
    return replace(scheme, parts=times * scheme.parts)


def mergeable(plant: Plant) -> int:
    """How many declared steps the symmetric scheme may take as one, by the limits of `refined`."""
    simulator = plant.form.simulator
    if simulator is not None and not simulator.takes_step:
        return 1
    longest_s = FINE_RAD / max(_fastest(plant), FINE_RAD / FINE_S)
    return max(1, int(longest_s / plant.timestep_s + 1e-9))


def _fastest(plant: Plant) -> float:
    """The nominal model's fastest oscillation [rad/s]."""
    modes = np.linalg.eigvals(plant.dynamics.transition(np.array(plant.parameters), NEAR_S))
    return float(np.abs(np.angle(modes)).max()) / NEAR_S


@dataclass(frozen=True)
class Samples:
    """Arrays over samples, as the kernel takes them: `t_s` [s]; `steps` of `h_s` [s] until the next
    sample; `issued`, the mean command until then, its `rise` meanwhile and its `integral`
    `(samples, joints)`; `observed` `(samples, 2 x joints)` are positions and velocities, `usable`
    what counts of them; `window_of` is the window to which a sample belongs, `resets` the window
    that starts at it, -1 where there is none."""

    t_s: Array
    h_s: Array
    steps: NDArray[np.int64]
    issued: Array
    rise: Array
    integral: Array
    observed: Array
    usable: NDArray[np.bool_]
    window_of: NDArray[np.int64]
    resets: NDArray[np.int64]


@dataclass(frozen=True)
class Series(Samples):
    """One episode for the kernel: its samples, and how they are integrated and cut.

    `begin` `(windows, 2 x joints)` are first guesses of the windows' starting states,
    `begin_by_positions` the same with velocities that positions show; `u_scale` `(joints,)` are the
    commands' declared limits.
    """

    digest: str
    scheme: Scheme
    begin: Array
    begin_by_positions: Array
    period_s: float
    u_scale: Array


def series(
    plant: Plant,
    episode: Episode,
    scheme: Scheme,
    window_s: float,
    parts: int = 1,
    merged: int = 1,
) -> Series:
    """An episode cut into windows of about `window_s` [s], all of one length; the last one ends
    with the episode. Each in `parts`; so many declared steps `merged` into one, where samples lie
    so far apart."""
    t = episode.t_s
    begins = known_from(plant, episode)
    span = t[-1] - t[begins]
    count = max(1, round(span / window_s)) * parts
    first = starts_every(t[:-1], span / count * (1 + 1e-9), float(t[begins]))
    return whole(plant, episode, scheme, first, merged=merged)


def whole(
    plant: Plant,
    episode: Episode,
    scheme: Scheme,
    first: NDArray[np.int64],
    begin: Array | None = None,
    merged: int = 1,
) -> Series:
    """An episode with windows that start at the `first` samples `(windows,)`, from where they
    `begin`, else from smoothed states."""
    t = since_the_recording_began(episode)
    h, steps = intervals(t, merged * plant.timestep_s)
    observed = positions_and_velocities(plant, episode)
    resets = np.full(len(t), -1)
    resets[first] = np.arange(len(first))
    limited = np.clip(episode.commands, *plant.limits)
    issued, rise = (
        np.ascontiguousarray(plant.at_joints(x))
        for x in plant.over_intervals(limited, ramped=scheme.ramped)
    )
    return Series(
        t_s=t,
        h_s=h / scheme.parts,
        steps=steps * scheme.parts,
        issued=issued,
        rise=rise,
        integral=integral_of(issued, t),
        observed=np.nan_to_num(observed),
        usable=np.isfinite(observed) & ~held_frames(observed, t),
        window_of=np.cumsum(resets >= 0) - 1,
        resets=resets,
        digest=episode.digest,
        scheme=scheme,
        begin=smoothed_states(plant, episode, first) if begin is None else begin,
        begin_by_positions=smoothed_states(plant, episode, first, from_positions=True)
        if begin is None
        else begin,
        period_s=episode.period_s,
        u_scale=plant.command_scales,
    )


def since_the_recording_began(episode: Episode) -> Array:
    """Times of an episode's samples `(samples,)` [s] since its recording began, of which it may be
    a part: what drifts goes on drifting through a gap."""
    if not episode.begins_s:
        return episode.t_s
    return np.asarray(episode.begins_s + episode.t_s)


def integral_of(issued: Array, t_s: Array) -> Array:
    """Integral of a command, by its mean over each interval, up to each sample, `(samples,
    joints)`."""
    return np.concatenate(
        [np.zeros_like(issued[:1]), np.cumsum(issued[:-1] * np.diff(t_s)[:, None], axis=0)]
    )


def positions_and_velocities(plant: Plant, episode: Episode) -> Array:
    """What was observed of them, nan where it was not, `(samples, 2 x joints)`."""
    observed = np.full((len(episode.t_s), 2 * len(plant.joints)), np.nan)
    observed[:, plant.state_columns] = episode.observations
    return observed


def unobserved(
    scheme: Scheme, t_s: Array, command: Array, u_scale: Array, period_s: float
) -> Series:
    """A command `(samples, joints)` at `t_s` [s] that nobody recorded an answer to, from rest, in
    one window."""
    n, command = len(t_s), np.ascontiguousarray(command)
    steps, resets = np.full(n, scheme.parts), np.full(n, -1)
    steps[-1], resets[0] = 0, 0
    zeros = np.zeros((n, 2 * command.shape[1]))
    return Series(
        digest="",
        scheme=scheme,
        t_s=t_s,
        h_s=np.full(n, period_s / scheme.parts),
        steps=steps,
        issued=command,
        rise=np.zeros_like(command),
        integral=integral_of(command, t_s),
        observed=zeros,
        usable=zeros == 0.0,
        window_of=np.zeros(n, np.int64),
        resets=resets,
        begin=np.zeros((1, zeros.shape[1])),
        begin_by_positions=np.zeros((1, zeros.shape[1])),
        period_s=period_s,
        u_scale=u_scale,
    )


def held_frames(observed: Array, t_s: Array) -> NDArray[np.bool_]:
    """Which of each joint's samples at `t_s` [s] were held, `(samples, 2 x joints)`."""
    joints = observed.shape[1] // 2
    return np.tile(
        np.stack([held(observed[:, [j, joints + j]], t_s) for j in range(joints)], axis=1), 2
    )


def held(observed: Array, t_s: Array) -> NDArray[np.bool_]:
    """Which samples repeat the one before it while the joint moves, `(samples,)`, of a joint's
    position and velocity `(samples, 2)`: frames that never arrived.

    A sensor coarser than its noise repeats values by itself, and a joint at rest without noise
    does; neither is counted: by its velocity the position must have moved by some steps of its
    sensor.
    """
    seen = np.isfinite(observed).any(axis=0)
    known = observed[:, seen]
    fresh: NDArray[np.bool_] = np.ones(len(known), np.bool_)
    fresh[1:] = (np.diff(known, axis=0) != 0.0).any(axis=1)
    if min((len(np.unique(c)) for c in known[fresh].T), default=0) < DISTINCT * fresh.sum():
        return np.zeros(len(known), np.bool_)
    if bool(np.isfinite(observed[:, 1]).any()):
        if not np.nanmax(np.abs(np.diff(observed[:, 0])), initial=0.0):
            return np.zeros(len(known), np.bool_)
        travel = np.abs(observed[:, 1]) * np.diff(t_s, prepend=t_s[0])
        moved = travel > STEPS * sensor_step(observed[:, 0])
        return np.asarray(np.logical_not(fresh) & moved)
    runs: NDArray[np.int64] = np.cumsum(fresh)  # of one value each, counted from 1
    many = np.bincount(runs)
    short = (many > 1) & (many < AT_REST)
    # from each run to the next
    steps = np.abs(np.diff(observed[fresh, 0], append=[np.nan, np.nan]))
    caught_up = steps[:-1][short[1:]] > CATCHES_UP * steps[1:][short[1:]]
    lost = bool(len(caught_up) and caught_up.mean() > MOSTLY)
    return np.asarray(np.logical_not(fresh) & short[runs] & lost)


def finest_step(values: Array) -> float:
    """The smallest difference of two values, 0 where there is none: a sensor's step, if it has
    one."""
    distinct = np.unique(values[np.isfinite(values)])
    gaps = np.diff(distinct)
    gaps = gaps[gaps > ROUNDING * (distinct[-1] - distinct[0])] if len(distinct) > 1 else gaps
    return float(gaps.min()) if len(gaps) else 0.0


def sensor_step(values: Array) -> float:
    """The step of the lattice on which values lie, 0 where they lie on none."""
    finest = finest_step(values)
    gaps = np.diff(np.unique(values[np.isfinite(values)])) / finest if finest else np.zeros(0)
    on_it = np.abs(gaps - np.rint(gaps)) < OFF_LATTICE
    return finest if len(gaps) and float(np.mean(on_it)) > ON_LATTICE else 0.0


def seen_by(s: Series, late_s: Array) -> tuple[NDArray[np.int64], Array]:
    """The window whose motion each sample shows, and how much each counts, `(samples, 2 x joints)`
    each, where joints are seen `late_s`.

    What a late sensor shows of the time before the log is no window's, -1; what is left of its
    samples counts for those too.
    """
    shown = np.searchsorted(s.t_s, s.t_s[:, None] - late_s, side="right") - 1
    windows = np.where(shown >= 0, s.window_of[shown], -1)
    weight = np.sqrt(len(shown) / np.maximum((shown >= 0).sum(axis=0), 1))
    return np.tile(windows, 2), np.tile(np.broadcast_to(weight, shown.shape), 2)
