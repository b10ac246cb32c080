"""Kinds of predictors: what a manifest's `kind` can name."""

from __future__ import annotations

from collections.abc import Mapping

from trueup.model.corrected import Corrected
from trueup.model.predictor import Blind, Conditioned, Identified, Nominal, Predictor, Residual

KINDS: Mapping[str, type[Predictor]] = {
    k.kind: k for k in (Nominal, Identified, Blind, Conditioned, Residual, Corrected)
}
