"""Locate: where the residual lies: in which channel, at which port, in which region, in which band
of frequency.

The residual of a region is what the refitted nominal form misses over a short stride, so that one
place's error is not carried to the next; a region counts for as much as it holds more of the
residual than of the time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import periodogram

from trueup.canonical import Json
from trueup.diagnose.candidate import Candidate
from trueup.diagnose.regions import regions, used
from trueup.diagnose.search import Search
from trueup.diagnose.tuning_of_answers import EVIDENCE
from trueup.diagnose.windowed_fits import trajectory
from trueup.episode.episode import Episode
from trueup.fit.rollout_fit import RolloutFit, Start
from trueup.model.block import kind
from trueup.model.effect import effects
from trueup.model.hypothesis import Hypothesis
from trueup.model.plant import Plant
from trueup.model.series import whole
from trueup.model.state import smoothed_states

Array = NDArray[np.float64]
NORMAL_MEDIAN = 0.6745  # of absolute standard normals


@dataclass(frozen=True, slots=True)
class Strides:
    """What a fit misses over short strides: residual force, and where each stride was, `(strides,
    joints)` each.

    `missed` `(strides, 2 x joints)` is by how much the state at a stride's end differs from the
    prediction.

    Forces are in units of each joint's own inertia, so a single joint's are accelerations. What a
    joint's force does to the others is taken out by the mass matrix: `travelled` is the residual
    acceleration before that. `motion` is the acceleration itself; `turned` whether a joint did, `t`
    of the episode, `episode` and `spacing_s`, from one stride to the next, `(strides,)` each.
    """

    missed: Array
    residual: Array
    travelled: Array
    motion: Array
    q: Array
    v: Array
    u: Array
    t: Array
    use: Array
    turned: NDArray[np.bool_]
    episode: NDArray[np.int64]
    spacing_s: Array


def locate(
    plant: Plant,
    search: Search,
    winner: Candidate,
    nominal: RolloutFit,
    adaptation: Sequence[Episode],
    validation: Sequence[Episode],
) -> dict[str, Json]:
    """Shares of the residual by channel, by port, by region and by band of frequency; of a robot,
    when something outside pushes."""
    base, episodes = search.candidates[Hypothesis()], [*adaptation, *validation]
    strides = strides_of(plant, search, base.fit, episodes)
    force, moved = _by_joint(strides)
    worst = int(np.argmax(force))
    where: dict[str, Json] = {
        "channels": _channels(plant, search, nominal),
        "ports": _ports(search, base),
        "regions": _regions(strides, worst),
        "bands": _bands(strides, worst),
    }
    if plant.names_joints:
        named = [plant.joint_name(j) for j in range(len(plant.joints))]
        shares = zip(
            named,
            force / max(force.sum(), 1e-300),
            moved / max(moved.sum(), 1e-300),
            np.sqrt(force),
            strict=True,
        )
        where["joints"] = [
            {"joint": n, "force": float(f), "acceleration": float(a), "of_motion": float(m)}
            for n, f, a, m in shares
        ]
        where["regions_of"] = plant.joint_name(worst)
        where["pushed"] = _pushed(
            plant,
            strides if winner is base else strides_of(plant, search, winner.fit, episodes),
            episodes,
        )
    return where


def _pushed(plant: Plant, s: Strides, episodes: Sequence[Episode]) -> list[Json]:
    """When a force that the answer does not explain leans on a joint for long, always the same way,
    as a contact does.

    No effect of a joint does that at one time and not at others; what is usual is the median of the
    whole log.
    """
    usual = np.maximum(np.nanmedian(np.abs(s.residual), axis=0) / NORMAL_MEDIAN, 1e-12)
    least = np.maximum(
        EVIDENCE.pushed * usual,
        EVIDENCE.pushed_of_motion * np.sqrt(np.nanmean(s.motion**2, axis=0)),
    )
    pushes: list[tuple[int, float, float, int, float]] = []
    for count, e in enumerate(episodes):
        rows = s.episode == count
        t = s.t[rows] * e.t_s[-1]
        stride = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
        for j in range(s.residual.shape[1]):
            force = s.residual[rows, j]
            for way in (1.0, -1.0):
                at = np.flatnonzero(way * force > least[j])
                for run in np.split(at, np.flatnonzero(np.diff(at) > 2) + 1):  # noqa: PLR2004  (one stride may be less)
                    if len(run) * stride >= EVIDENCE.pushed_s:
                        begin, end = (
                            float(t[run[0]]) - stride / 2.0,
                            float(t[run[-1]]) + stride / 2.0,
                        )
                        pushes.append((count, begin, end, j, float(way * np.max(way * force[run]))))
    entries: list[Json] = []
    for count, e in enumerate(episodes):
        spans: list[list[float]] = []
        mine = sorted(p for p in pushes if p[0] == count)
        for _, begin, end, _, _ in mine:
            if spans and begin <= spans[-1][1]:
                spans[-1][1] = max(spans[-1][1], end)
            else:
                spans.append([begin, end])
        for begin, end in spans:
            by = {
                j: force
                for _, b, _, j, force in sorted(mine, key=lambda p: abs(p[4]))
                if begin <= b <= end
            }
            joints: list[Json] = [
                {"joint": plant.joint_name(j), "force": force} for j, force in sorted(by.items())
            ]
            entries.append(
                {
                    "episode": e.recording,
                    "from_s": round(e.begins_s + begin, 2),
                    "to_s": round(e.begins_s + end, 2),
                    "joints": joints,
                }
            )
    return entries


def _by_joint(s: Strides) -> tuple[Array, Array]:
    """Mean square residual force of each joint, in units of the force of its own motion, and the
    same of the residual acceleration, of which a part only travelled there through the coupling.
    """
    size = np.sqrt(np.nanmean(s.motion**2, axis=0))
    return np.nanmean((s.residual / size) ** 2, axis=0), np.nanmean(
        (s.travelled / size) ** 2, axis=0
    )


def _channels(plant: Plant, search: Search, nominal: RolloutFit) -> list[Json]:
    names = {
        int(column): c.name
        for column, c in zip(plant.state_columns, plant.layout.observations, strict=True)
    }
    squares = np.zeros(2 * len(plant.joints))
    for s in search.problem.validation:
        missed = (
            s.observed - trajectory(search.problem.fitter, nominal, s)
        ) / search.problem.fitter.sigma
        squares += np.where(s.usable, missed**2, 0.0).sum(axis=0)
    whole_ = max(float(squares.sum()), 1e-300)
    return [
        {"channel": name, "share": float(squares[column] / whole_)}
        for column, name in names.items()
    ]


def _ports(search: Search, base: Candidate) -> list[Json]:
    """The part of the remaining gap that the best single effect at each port takes away."""
    best: dict[str, tuple[float, str]] = {}
    for c in search:
        if len(c.hypothesis.effects) == 1:
            name = kind(c.hypothesis.effects[0]).name
            part = 1.0 - (c.reduced_chi_square - 1.0) / max(base.reduced_chi_square - 1.0, 1e-9)
            best[effects()[name].port.reported] = max(
                best.get(effects()[name].port.reported, (0.0, "")),
                (float(np.clip(part, 0.0, 1.0)), name),
            )
    return [
        {"port": port, "share": part, "by": name}
        for port, (part, name) in sorted(best.items(), key=lambda item: -item[1][0])
    ]


def strides_of(
    plant: Plant, search: Search, of: RolloutFit, episodes: Sequence[Episode]
) -> Strides:
    """What a fit misses over strides of EVIDENCE.stride_s."""
    parts, joints = [], len(plant.joints)
    for count, e in enumerate(episodes):
        every = max(EVIDENCE.stride_samples, round(EVIDENCE.stride_s / e.period_s))
        first = np.arange(0, len(e.t_s) - every, every)
        s = whole(plant, e, search.problem.scheme, first)
        states = smoothed_states(plant, e)
        fit = replace(
            of,
            starts={
                s.digest: Start(
                    states[first], of.starts[e.digest].memory if e.digest in of.starts else {}
                )
            },
        )
        path = trajectory(search.problem.fitter, fit, s)
        end, middle = first + every - 1, first + every // 2
        span = (e.t_s[end] - e.t_s[first])[:, None]
        state_error = states[end] - path[end]
        missed = state_error[:, joints:] / span
        motion = (states[end, joints:] - states[first, joints:]) / span
        inertia = plant.dynamics.inertia(
            of.values[: len(plant.parameters)], states[middle, :joints]
        )
        u = plant.applied(e.commands)
        parts.append(
            (
                state_error,
                np.einsum("sij,sj->si", inertia, missed),
                missed,
                np.einsum("sij,sj->si", inertia, motion),
                states[middle, :joints],
                states[middle, joints:],
                u[middle],
                e.t_s[middle] / e.t_s[-1],
                used(u, e)[middle],
                states[first, joints:] * states[end, joints:] < 0.0,
                np.full(len(first), count),
                np.full(len(first), every * e.period_s),
            )
        )
    return Strides(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _regions(s: Strides, j: int) -> list[Json]:
    """Where one joint's residual force lies."""
    energy = s.residual[:, j] ** 2
    fine = np.isfinite(energy)
    parts = regions(s.q[:, j], s.v[:, j], s.u[:, j], s.t, s.use[:, j], s.turned[:, j])
    whole_ = max(float(energy[fine].sum()), 1e-300)
    lifts: list[tuple[float, Json]] = []
    for name, inside in parts.items():
        time, share = float((inside & fine).mean()), float(energy[inside & fine].sum() / whole_)
        if time > 0.0:
            lifts.append(
                (
                    share / time,
                    {"region": name, "share": share, "of_time": time, "lift": share / time},
                )
            )
    return [entry for _, entry in sorted(lifts, key=lambda pair: -pair[0])]


def _bands(s: Strides, j: int) -> list[Json]:
    """The residual's energy in each band of frequency, beside the motion's own; what the strides
    cannot resolve is left out."""
    edges = [0.0, *EVIDENCE.band_edges_hz, np.inf]
    energy = np.zeros((2, len(edges) - 1))
    for count in np.unique(s.episode):
        rows = s.episode == count
        series = np.nan_to_num(np.stack([s.residual[rows, j], s.motion[rows, j]]))
        rate, power = periodogram(series, 1.0 / s.spacing_s[rows][0], "hann")
        for band in range(len(edges) - 1):
            energy[:, band] += power[:, (rate >= edges[band]) & (rate < edges[band + 1])].sum(
                axis=1
            )
    share = energy / np.maximum(energy.sum(axis=1, keepdims=True), 1e-300)
    entries: list[Json] = []
    for low, high, residual, motion in zip(edges[:-1], edges[1:], *share, strict=True):
        name = (
            f"below {high:g} Hz"
            if low == 0.0
            else f"above {low:g} Hz"
            if high == np.inf
            else f"{low:g} to {high:g} Hz"
        )
        entries.append({"band": name, "share": float(residual), "of_motion": float(motion)})
    return entries
