"""Explain: estimates with intervals, each effect's share of the gap, what the data speak against, what they could not show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueup.canonical import Json
from trueup.diagnose.admission import Admission
from trueup.diagnose.decide import Choice
from trueup.diagnose.search import RESOLUTION, Candidate, Search, has_already, searchable
from trueup.fit.rollout_fit import Fitter, RolloutFit, in_parallel
from trueup.model.effect import Effect, Number, Scale, effects
from trueup.model.plant import Plant

Array = NDArray[np.float64]
TWO_SIDED = 1.96  # standard errors of a 95 % interval
BOUNDING = 3.0  # standard errors of a bound: what the linear model neglects is among them
LINEAR = 1.5  # times a start: up to there what was computed at the start is believed
RIDGE = 1e-12  # of a determined direction's information
WIDEST = 1e7  # steps of a finite difference: an interval so wide says that nothing is known
HELD = 0.005  # of the frames: fewer make no gap worth a name
RULED_OUT = 0.5  # of a limit's whole effect


@dataclass(frozen=True, slots=True)
class Bound:
    """What the data say of one effect that was not found: how large it may be, or why they cannot tell."""

    effect: str
    parameter: str
    value: float | None
    falls: bool
    unit: str
    why: str

    def document(self) -> dict[str, Json]:
        """The same as JSON."""
        if self.value is None:
            return {"effect": self.effect, "why": self.why}
        side = "above" if self.falls else "below"
        return {"effect": self.effect, "parameter": self.parameter, side: self.value, "unit": self.unit, "confidence": 0.95}


def unit(scale: Scale, plant: Plant) -> str:
    """A scale in the plant's declared units."""
    q = next((c.unit for c in plant.layout.observations), "") or "1"
    u = plant.layout.commands[0].unit or "1"
    return {
        Scale.ACCELERATION: f"{q}/s^2",
        Scale.VELOCITY: f"{q}/s",
        Scale.POSITION: q,
        Scale.COMMAND: u,
        Scale.RATE: f"{u}/s",
        Scale.TIME: "s",
        Scale.ONE: "1",
        Scale.DRAG: f"1/{q}",
        Scale.CUBIC: f"1/({q}^2 s^2)",
        Scale.DRIFT: f"{q}/s",
        Scale.STIFFNESS: "1/s^2",
        Scale.DAMPING: "1/s",
    }[scale]


def half_widths(fit: RolloutFit, coarse: RolloutFit) -> dict[tuple[str, str], float]:
    """Half of each 95 % interval, by (effect or "", parameter); scaled by what the fit leaves unexplained.

    How far an estimate moves between coarse and fine steps of integration is added in quadrature, for a machine has no step. A number
    between whose corners the error is flat has the width of the grid on which it was found, and the others what gives way to that.
    """
    if not len(fit.free.rows):
        return {}
    rest = np.array([e == "" or effects()[e].zoomed != n for e, n in fit.free.names])
    information = fit.information[np.ix_(rest, rest)]
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    inverse = np.linalg.inv(information / size[:, None] / size + RIDGE * np.eye(len(size))) / size[:, None]
    grid = np.where(rest, 0.0, RESOLUTION * fit.values[fit.free.rows])
    grid[rest] = inverse @ (fit.information[np.ix_(rest, ~rest)] @ grid[~rest] / size)
    variance = np.zeros(len(rest))
    with np.errstate(over="ignore"):  # what is not determined is wide
        variance[rest] = np.abs(np.diag(inverse)) / size
    moved = fit.values[fit.free.rows] - coarse.values[fit.free.rows]
    width = np.sqrt(TWO_SIDED**2 * variance * max(fit.misfit, 1.0) + moved**2 + grid**2)
    return {name: float(w) for name, w in zip(fit.free.names, np.minimum(width, WIDEST * fit.free.step), strict=True)}


def estimates(fit: RolloutFit, coarse: RolloutFit, fitter: Fitter, plant: Plant, share: Mapping[str, float]) -> list[Json]:
    """A fit's effects with estimates, units, intervals and shares; `coarse` is the same on the search's steps."""
    widths = half_widths(fit, coarse)
    found: list[Json] = []
    for name in fit.hypothesis.effects:
        kind = effects()[name]
        values: dict[str, Json] = {}
        for number in kind.params:
            if (name, number.name) not in widths:
                continue  # the log did not ask for it
            value = fit.parameters(name)[number.name]
            low, high = _inside(value, widths[name, number.name], number, fitter)
            values[number.name] = {"value": value, "unit": unit(number.scale, plant), "ci95": [low, high]}
        found.append(_entry(kind, values, share.get(name, 0.0), plant))
    return found


def counted(admission: Admission, plant: Plant, samples: int) -> list[Json]:
    """Effects that are counted in the samples themselves: held frames and coarse lattices."""
    found: list[Json] = []
    if admission.held > HELD:
        error = TWO_SIDED * float(np.sqrt(admission.held * (1.0 - admission.held) / samples))
        value: Json = {"value": admission.held, "unit": "1", "ci95": [max(admission.held - error, 0.0), admission.held + error]}
        found.append(_entry(effects()["dropped_frames"], {"fraction": value}, 0.0, plant))
    if admission.coarse.any():
        steps: dict[str, Json] = {
            n.name: {"value": float(step), "unit": unit(n.scale, plant), "ci95": [float(step), float(step)]}
            for n, step, coarse in zip(effects()["sensor_quantization"].params, admission.lattice, admission.coarse, strict=True)
            if coarse
        }
        found.append(_entry(effects()["sensor_quantization"], steps, 0.0, plant))
    return found


def _entry(kind: type[Effect], values: dict[str, Json], share: float, plant: Plant) -> dict[str, Json]:
    joint = plant.layout.observations[0].joint or "joint"
    port = kind.port.reported
    return {"effect": kind.name, "port": port, "channel": joint, "category": kind.category, "estimate": values, "share": share}


def _inside(value: float, width: float, number: Number, fitter: Fitter) -> tuple[float, float]:
    scale = fitter.scales.of(number.scale)
    return max(value - width, number.low * scale), min(value + width, number.high * scale)


def parameter_table(plant: Plant, fit: RolloutFit, coarse: RolloutFit) -> dict[str, Json]:
    """Nominal and fitted parameters with 95 % intervals."""
    widths, values = half_widths(fit, coarse), fit.parameters()
    return {
        name: {"nominal": nominal, "value": values[name], "ci95": [values[name] - widths["", name], values[name] + widths["", name]]}
        for name, nominal in plant.nominal.items()
    }


def shares(search: Search, choice: Choice, nominal: RolloutFit) -> dict[str, float]:
    """Each effect's share of the gap on validation episodes: what comes back of it when the effect is removed and the rest refitted.

    They do not add up: what two effects can explain as well as one belongs to neither, and what parameters explain is the rest.
    """
    winner = choice.winner
    whole = max(nominal.misfit, winner.misfit) - winner.misfit
    back = {n: max(search.fitted(winner.hypothesis.without(n), winner).misfit - winner.misfit, 0.0) for n in winner.hypothesis.effects}
    scale = max(whole, sum(back.values()), 1e-12)
    return {name: comes_back / scale for name, comes_back in back.items()}


def bounds(search: Search, winner: Candidate, plant: Plant) -> tuple[list[Bound], list[Bound]]:
    """Of each effect that the winner has not: a bound, or why there is none. Two lists."""
    names = [n for n in searchable() if not has_already(winner.hypothesis, n)]
    found = list(in_parallel(lambda name: _bound(search, winner, name, plant), names))
    return [b for b in found if b.value is not None], [b for b in found if b.value is None]


def _bound(search: Search, winner: Candidate, name: str, plant: Plant) -> Bound:
    kind, fitter = effects()[name], search.fitter
    screened = fitter.screen(search.adaptation, winner.fit, name)
    error = BOUNDING * screened.error * np.sqrt(max(winner.fit.misfit, 1.0))
    number = kind.params[0]
    starts = np.array([max(abs(s[0]), abs(s[1]) if kind.periodic else 0.0) for s in kind.starts]) * fitter.scales.of(number.scale)
    measure = unit(number.scale, plant)
    if kind.falls:
        ruled_out = screened.factor + error < RULED_OUT
        order = np.argsort(starts)  # the strongest first
        last = int(np.argmin(np.append(ruled_out[order], False)))
        value = float(starts[order][last - 1]) if last else None
        return Bound(name, number.name, value, True, measure, "" if last else _blind(kind))
    limits = (np.abs(screened.factor) + error) * starts
    if kind.zoomed:  # small ones do not grow in proportion: what would have been seen whole bounds
        limits = np.where(limits < starts, starts, np.inf)
    shapes: dict[tuple[float, ...], float] = {}
    for s, limit, start in zip(kind.starts, limits, starts, strict=True):
        if start > 0.0:  # the others have none of the number that is bounded
            shape = s if kind.periodic else s[1:]
            shapes[shape] = min(shapes.get(shape, np.inf), limit if limit <= LINEAR * start else np.inf)
    sound = [limit for limit in shapes.values() if np.isfinite(limit)]  # of the shapes that would have shown
    if not sound:
        return Bound(name, number.name, None, False, measure, _blind(kind))
    return Bound(name, number.name, float(max(sound)), False, measure, "")


def _blind(kind: type[Effect]) -> str:
    """The effect's own word on the data that cannot show it."""
    text = (kind.__doc__ or "").split("Blind:")[-1]
    return " ".join(text.split())
