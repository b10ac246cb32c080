"""Laws of a predictor: rows are independent, it never writes to its inputs, and packing it as an
artifact changes no bit."""

from __future__ import annotations

import numpy as np

from trueup.artifact.artifact import pack, unpack
from trueup.checks.law import require
from trueup.model.predictor import Predictor

ROWS = 9
ROUNDING = 1e-12  # a product of one row and of many may order additions otherwise


def rows_are_independent(predictor: Predictor) -> None:
    """A row's prediction does not depend on the other rows."""
    states, issued = _inputs(predictor)
    whole = predictor.predict_batch(states, issued)
    for i in range(ROWS):
        alone = predictor.predict_batch(states[i : i + 1], issued[i : i + 1])[0]
        require(
            np.allclose(alone, whole[i], rtol=ROUNDING, atol=ROUNDING),
            "rows are independent",
            predictor.kind,
        )


def inputs_stay_as_they_are(predictor: Predictor) -> None:
    """Predicting does not write to states or commands."""
    states, issued = _inputs(predictor)
    before = states.copy(), issued.copy()
    predictor.predict_batch(states, issued)
    require(
        np.array_equal(states, before[0]) and np.array_equal(issued, before[1]),
        "inputs stay as they are",
        predictor.kind,
    )


def it_survives_as_an_artifact(predictor: Predictor) -> None:
    """A predictor that is packed and unpacked predicts the same bits, and packs to the same
    digest."""
    artifact = pack(predictor, {"origin": "law"})
    back = unpack(artifact, artifact.digest)
    inputs = _inputs(predictor)
    require(
        np.array_equal(back.predict_batch(*inputs), predictor.predict_batch(*inputs)),
        "it survives as an artifact",
        predictor.kind,
    )
    require(
        pack(back, {"origin": "law"}).digest == artifact.digest,
        "it survives as an artifact",
        predictor.kind,
        "another digest",
    )


def _inputs(predictor: Predictor) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    return rng.normal(size=(ROWS, 2 * predictor.plant.dynamics.joints)), rng.normal(
        size=(ROWS, len(predictor.plant.layout.commands))
    )


LAWS = (rows_are_independent, inputs_stay_as_they_are, it_survives_as_an_artifact)
