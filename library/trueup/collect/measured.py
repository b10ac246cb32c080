"""Measured: the conditions under which an episode was collected, whether it kept the envelope, and
what it can determine.

No episode is refused here: a recording that went wrong is worth keeping. Warnings say what is
wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.collect.coverage import Coverage, compared
from trueup.collect.required import ON_A_MACHINE
from trueup.collect.safeguards import held_against
from trueup.collect.step_warning import off_step
from trueup.episode.episode import Episode
from trueup.episode.role import STAGES, Role
from trueup.model.plant import Plant
from trueup.model.state import smoothed_states

Array = NDArray[np.float64]
CONDITIONS = ("stage", "envelope", "safeguards", "supervisor", "stop_criterion", "excitation")
SINGULAR = 1e-6  # of the regressors with columns of unit length
WEAK = 30.0  # condition number of a design that amplifies noise much
SAME = 1e-6  # of the command's range
STILL = 0.05  # of the command's range: less is hardly an excitation


def measured(plant: Plant, episode: Episode, fitted_on: Sequence[Coverage] = ()) -> dict[str, Json]:
    """Conditions, envelope, excitation, how much of the episode lies where the serving model was
    `fitted_on`, and warnings in words."""
    off = off_step(episode.period_s, plant.timestep_s)
    warnings = [*([off] if off else []), *episode.clock_doubts]
    record: dict[str, Json] = {
        "conditions": _conditions(episode, warnings),
        "safeguards": held_against(plant, episode, warnings),
        "envelope": _envelope(plant, episode, warnings),
        "excitation": _excitation(plant, episode, warnings),
        "applied": _applied(episode, warnings),
        "outside": compared(plant, episode, fitted_on, warnings) if fitted_on else None,
    }
    return {**record, "warnings": list(warnings)}


def _conditions(episode: Episode, warnings: list[str]) -> dict[str, Json]:
    """The declared collection conditions, and those that are not declared."""
    declared = {name: episode.conditions[name] for name in CONDITIONS if name in episode.conditions}
    stage = declared.get("stage")
    if stage is None:
        warnings.append(
            f"the stage is not declared: it says what this recording can show ({', '.join(STAGES)})"
        )
    elif stage not in STAGES:
        warnings.append(f"the stage {stage!r} is none of {', '.join(STAGES)}")
    missing = [
        name for name in ("safeguards", "supervisor", "stop_criterion") if name not in declared
    ]
    if stage in ON_A_MACHINE and missing:
        warnings.append(
            "recorded on a machine, and its metadata do not say: "
            f"{', '.join(missing).replace('_', ' ')}"
        )
    return {
        "declared": dict(declared),
        "missing": [name for name in CONDITIONS if name not in declared],
    }


def _envelope(plant: Plant, episode: Episode, warnings: list[str]) -> dict[str, Json]:
    """For each channel with a declared range, the samples outside it: how many, the first [s], and
    how far the worst is."""
    breaches: dict[str, Json] = {}
    for channel, values in zip(plant.layout.observations, episode.observations.T, strict=True):
        if channel.name not in plant.envelope:
            continue
        low, high = plant.envelope[channel.name]
        beyond = np.maximum(low - values, values - high)
        outside = np.flatnonzero(beyond > 0.0)
        if len(outside):
            worst = int(np.nanargmax(beyond))
            breaches[channel.name] = {
                "samples": len(outside),
                "share": len(outside) / len(values),
                "first_s": float(episode.t_s[outside[0]]),
                "worst": float(values[worst]),
            }
            warnings.append(
                f"{channel.name} left its envelope [{low:g}, {high:g}] {channel.unit} in "
                f"{len(outside)} samples, first at "
                f"{episode.t_s[outside[0]]:.3g} s, as far as {values[worst]:.4g}"
            )
    return {"declared": bool(plant.envelope), "breaches": breaches}


def _excitation(plant: Plant, episode: Episode, warnings: list[str]) -> dict[str, Json] | None:
    """Rank and condition of the regression that a family's numbers are identified by, and the part
    of the command's range that was used."""
    applied = plant.applied(episode.commands)
    low, high = plant.limits
    used = np.ptp(episode.commands, axis=0) / np.maximum(high - low, 1e-12)
    if episode.role in (Role.ADAPTATION, Role.TRAINING) and (used < STILL).any():
        still = [
            c.name for c, part in zip(plant.layout.commands, used, strict=True) if part < STILL
        ]
        warnings.append(
            f"{', '.join(still)} hardly moves: {100 * float(used.min()):.1f} % of the range"
        )
    at_limit = ((episode.commands <= low) | (episode.commands >= high)).mean(axis=0)
    record: dict[str, Json] = {
        "range_used": {
            c.name: float(part) for c, part in zip(plant.layout.commands, used, strict=True)
        },
        # where it is 0, nothing was seen of the limit: it is not identified
        "saturated": {
            c.name: float(part) for c, part in zip(plant.layout.commands, at_limit, strict=True)
        },
    }
    columns = plant.dynamics.own_regressors(smoothed_states(plant, episode), applied)
    if columns is None:
        return {**record, "rank": None, "condition": None, "numbers": None}
    rank, condition = _rank(columns[np.isfinite(columns).all(axis=1)])
    names = plant.dynamics.parameter_names
    if episode.role in (Role.ADAPTATION, Role.TRAINING):
        if rank < len(names):
            warnings.append(
                f"the motion tells {rank} of the {len(names)} numbers {', '.join(names)}: "
                "move at several speeds, both ways"
            )
        elif condition > WEAK:
            warnings.append(
                f"the parameters {', '.join(names)} are poorly separated: condition {condition:.0f}"
            )
    return {
        **record,
        "rank": rank,
        "condition": condition if np.isfinite(condition) else None,
        "numbers": len(names),
    }


def _applied(episode: Episode, warnings: list[str]) -> dict[str, Json] | None:
    """How far the applied commands that were recorded differ from what the declared limits leave of
    the issued ones, by channel; None where none were recorded."""
    if episode.applied is None:
        return None
    record: dict[str, Json] = {}
    pairs = zip(episode.layout.commands, episode.within_limits.T, episode.applied.T, strict=True)
    for channel, limited, applied in pairs:
        apart = np.abs(applied - limited)[np.isfinite(applied)]
        reach = float(np.ptp(channel.limits or (0.0, 1.0)))
        differs = apart > SAME * reach
        share = float(differs.mean()) if len(apart) else None
        record[channel.name] = {"share": share, "largest": float(apart.max(initial=0.0))}
        if differs.any():
            warnings.append(
                f"the applied {channel.name} is not what the declared limits leave of the issued "
                f"one in {100 * differs.mean():.3g} % of the samples, by up to {apart.max():.3g} "
                f"{channel.unit}: something in the drive limits, delays or rounds it"
            )
    return record


def _rank(columns: Array) -> tuple[int, float]:
    """Rank and condition number of columns of unit length."""
    length = np.linalg.norm(columns, axis=0) if len(columns) else np.zeros(columns.shape[1])
    if not (length > 0.0).all():
        return int((length > 0.0).sum()), float("inf")
    powers: Any = np.linalg.svd(columns / length, compute_uv=False)
    rank = int((powers > SINGULAR * powers[0]).sum())
    return rank, float(powers[0] / powers[-1]) if rank == columns.shape[1] else float("inf")
