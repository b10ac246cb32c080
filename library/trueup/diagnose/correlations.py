"""Correlations: which numbers of a fit are off together.

Where motion shows a sum of two numbers better than each, their errors go together: intervals alone
would allow pairs of values that the recordings rule out.
"""

from __future__ import annotations

import numpy as np

from trueup.canonical import Json
from trueup.diagnose.intervals import covariance
from trueup.fit.free_numbers import Directions
from trueup.fit.rollout_fit import RolloutFit
from trueup.model.block import joint, kind
from trueup.model.plant import Plant

LEAST = 0.05  # a weaker correlation is none
DIGITS = 4


def correlations(fit: RolloutFit, directions: Directions, plant: Plant) -> list[Json]:
    """`[number, number, correlation]` of each pair of a fit's numbers that are off together. A
    number is named as in a family of plants: a parameter, or `EFFECT.NUMBER`, in a robot
    `EFFECT@JOINT.NUMBER`."""
    names, rows = list(plant.nominal), list[np.ndarray]()
    named = dict(zip(directions.names, directions.along, strict=True))
    effects: list[str] = []
    for term, number in fit.free.names:
        if term:
            at = f"@{plant.joint_name(joint(term))}" if plant.names_joints else ""
            effects.append(f"{kind(term).name}{at}.{number}")
    of_form = np.zeros((len(names), len(fit.free.names)))
    for k, (term, number) in enumerate(fit.free.names):
        if not term:
            of_form[:, k] = named[number]
        else:
            rows.append(np.eye(len(fit.free.names))[k])
    along = np.vstack([of_form, *rows]) if rows else of_form
    spread = along @ covariance(fit) @ along.T
    deviation = np.sqrt(np.maximum(np.diag(spread), 0.0))
    known = np.flatnonzero(deviation > 0.0)
    every, pairs = [*names, *effects], list[Json]()
    for n, i in enumerate(known):
        for j in known[n + 1 :]:
            value = float(spread[i, j] / deviation[i] / deviation[j])
            if abs(value) >= LEAST:
                pairs.append([every[i], every[j], round(min(max(value, -1.0), 1.0), DIGITS)])
    return pairs
