"""Laws of an effect: it vanishes at its null, every number of it matters, compiled and numpy agree,
it looks only back, a fit recovers its value, and its docstring states its equation, source and
blind spot."""

from __future__ import annotations

import inspect
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trueup.checks.law import require
from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.fit.fitter import Fitter
from trueup.fit.free_numbers import Directions
from trueup.model.block import BLOCK
from trueup.model.corrected import Corrected
from trueup.model.effect import Effect, Port
from trueup.model.hypothesis import Hypothesis, Scales, switches
from trueup.model.plant import Plant
from trueup.model.roll import roll
from trueup.model.series import DECLARED, Scheme, Series, whole

Array = NDArray[np.float64]
SAMPLES, PERIOD_S = 400, 0.02
SCALES = Scales(0.6, 0.5, 0.7, 1.0)
SYMMETRIC = Scheme(0.5, 2)
ROUNDING = 1e-9
VISIBLE = 1e-7  # of a channel: what a parameter must move
OFF_GRID, POINTS, GRIDS = 0.013, 31, 4  # the first grid does not hold the value
FOUND = 0.02  # of a value, or of its scale: how near a fit must come to it
PLANT = Plant.from_document(
    {
        "name": "law",
        "nominal": {
            "family": "oscillator",
            "parameters": {"k": 1.3, "c": 0.5, "b": 1.0},
            "timestep_s": PERIOD_S,
        },
        "commands": [{"name": "u", "unit": "m/s^2", "limits": [-1.0, 1.0]}],
        "observations": [{"name": "q", "unit": "m"}, {"name": "v", "unit": "m/s"}],
        "evaluation": {"horizon_s": 2.0},
    }
)


def _episode(commands: Array, observations: Array | None = None) -> Episode:
    t = np.asarray(np.arange(len(commands)) * PERIOD_S, np.float64)
    seen = np.zeros((len(t), 2)) if observations is None else observations
    return Episode(
        t, commands[:, None].copy(), seen.copy(), PLANT.layout, Role.ADAPTATION, {}, 0, "law"
    )


def _commands(seed: int = 0) -> Array:
    """Commands that excite every effect: steps, waves of many rates, and rests."""
    t = np.arange(SAMPLES) * PERIOD_S
    waves = 0.5 * np.sin(2.0 * np.pi * 0.35 * t) + 0.1 * np.sin(2.0 * np.pi * 1.7 * t)
    steps = np.repeat(np.random.default_rng(seed).uniform(-1.0, 1.0, SAMPLES // 25), 25)
    return np.asarray(np.clip(0.55 * steps + waves, -1.0, 1.0))


def _values(effect: type[Effect], start: int) -> Array:
    fitter = Fitter(
        PLANT.form, Directions.of_family(PLANT.dynamics.parameter_names), [SCALES], np.ones(2)
    )
    return fitter.with_effect(
        fitter.initial_values(PLANT.parameters), effect.name, _strong(effect, start)
    )


def _usual(effect: type[Effect]) -> int:
    """An effect's start of middling size."""
    return min(len(effect.starts) // 2, 8)


def _strong(effect: type[Effect], start: int) -> tuple[float, ...]:
    """One of the effect's own starts, with every number set; those that are weak on purpose are
    enlarged."""
    asked = dict(zip(effect.optional, effect.tries[0], strict=True)) if effect.tries else {}
    chosen = [
        asked.get(n.name, x) for n, x in zip(effect.params, effect.starts[start], strict=True)
    ]
    if effect.periodic:
        chosen[:2] = [0.1, 0.05]
    return tuple(chosen)


def _rolled(
    values: Array,
    effect: type[Effect] | None,
    scheme: Scheme,
    commands: Array,
    start: tuple[float, float] = (0.3, -0.2),
) -> Array:
    s = whole(PLANT, _episode(commands), scheme, np.array([0]))
    init = np.repeat(np.array([[start[0]], [start[1]]])[None], BLOCK, axis=2)
    on = switches(Hypothesis((effect.name,) if effect else ()))
    p = np.repeat(values[:, None], BLOCK, axis=1)
    return np.asarray(roll(s, PLANT.form, p, on, init)[:, :, 0])


def vanishes_at_its_null(effect: type[Effect]) -> None:
    """With its parameters at their nulls an effect changes no bit, under either integration
    scheme."""
    values = PLANT.block.nulls.copy()
    values[: len(PLANT.parameters)] = PLANT.parameters
    for scheme in (DECLARED, SYMMETRIC):
        same = np.array_equal(
            _rolled(values, effect, scheme, _commands()), _rolled(values, None, scheme, _commands())
        )
        require(same, "vanishes at its null", effect.name)


def every_parameter_matters(effect: type[Effect]) -> None:
    """There is a start from which changing any one parameter changes the observations."""
    for row, number in zip(PLANT.block.rows(effect.name), effect.params, strict=True):
        seen = 0.0
        for start in range(len(effect.starts)):
            values = _values(effect, start)
            moved = values.copy()
            moved[row] += 0.2 * max(abs(values[row]), 0.2 * SCALES.of(number.scale))
            changed = _rolled(moved, effect, SYMMETRIC, _commands()) - _rolled(
                values, effect, SYMMETRIC, _commands()
            )
            seen = max(seen, float(np.nan_to_num(np.abs(changed)).max()))
        require(seen > VISIBLE, "every parameter matters", effect.name, number.name)


def compiled_equals_numpy(effect: type[Effect]) -> None:
    """One compiled step gives what the effect's own function gives on arrays, its states as they
    begin."""
    if effect.port is Port.OBSERVATION or effect.delays():
        return  # they act on the log, not in a step
    rng = np.random.default_rng(3)
    values = _values(effect, _usual(effect))
    for scheme in (DECLARED, SYMMETRIC):
        single = replace(scheme, parts=1)
        model = Corrected(PLANT, Hypothesis((effect.name,)), tuple(values), single)
        for _ in range(20):
            state, u = rng.normal(size=2) * 0.6, rng.uniform(-1.0, 1.0)
            expected = model.predict_batch(state[None], np.array([[u]]))[0]
            compiled = _rolled(
                values, effect, single, np.array([u, u]), (float(state[0]), float(state[1]))
            )[1]
            require(
                np.allclose(compiled, expected, atol=ROUNDING),
                "compiled equals numpy",
                effect.name,
                f"{compiled} for {expected}",
            )


def looks_only_back(effect: type[Effect]) -> None:
    """Commands of the second half change nothing in the first."""
    commands, values = _commands(), _values(effect, _usual(effect))
    other = commands.copy()
    other[SAMPLES // 2 :] = -other[SAMPLES // 2 :]
    # the sample at which the first changed command starts to act is still the same
    half = SAMPLES // 2 + 1
    same = np.array_equal(
        _rolled(values, effect, SYMMETRIC, commands)[:half],
        _rolled(values, effect, SYMMETRIC, other)[:half],
        equal_nan=True,
    )
    require(same, "looks only back", effect.name)


def its_value_is_found_again(effect: type[Effect]) -> None:
    """A fit that begins a fifth off, on the side on which the effect acts, recovers the value from
    a noise-free log."""
    values = _values(effect, _usual(effect))
    number, row = effect.params[0], PLANT.block.rows(effect.name)[0]
    log = _rolled(values, effect, SYMMETRIC, _commands())
    if effect.counted:
        return  # its value is the lattice of the log's values, and no fit's
    s: Series = whole(PLANT, _episode(_commands(), log), SYMMETRIC, np.array([0]))
    fitter = Fitter(
        PLANT.form,
        Directions.of_family(PLANT.dynamics.parameter_names),
        [SCALES],
        np.array([1e-3, 1e-3]),
    )
    begin = values.copy()
    begin[row] = begin[row] * (0.8 if effect.falls else 1.2) + 1e-3 * SCALES.of(number.scale)
    others = [(effect.name, n.name) for n in effect.params[1:]]
    family = [("", name) for name in PLANT.dynamics.parameter_names]
    if (
        effect.grid_refined
    ):  # the error is flat between corners: ever finer grids find it, as a search's
        middle, half, fit = 1.0 + OFF_GRID, 0.2, None
        for _ in range(GRIDS):
            tried = [
                fitter.fit(
                    [s],
                    Hypothesis((effect.name,)),
                    np.where(np.arange(len(values)) == row, values[row] * factor, values),
                    iterations=0,
                )
                for factor in middle + half * np.linspace(-1.0, 1.0, POINTS)
            ]
            fit = min(tried, key=lambda f: f.cost)
            middle, half = float(fit.values[row] / values[row]), 2.0 * half / (POINTS - 1)
        assert fit is not None
    else:
        fit = fitter.fit(
            [s],
            Hypothesis((effect.name,)),
            begin,
            iterations=60,
            fixed=[*others, *family],
            tolerance=1e-12,
        )
    off = abs(fit.values[row] - values[row]) / max(
        abs(values[row]), FOUND * SCALES.of(number.scale)
    )
    require(
        off < FOUND,
        "its value is found again",
        effect.name,
        f"{number.name} {fit.values[row]:g} for {values[row]:g}",
    )


def it_documents_itself(effect: type[Effect]) -> None:
    """The docstring states the equation, its source, and the data that cannot show it; each state
    says where it begins."""
    text = inspect.getdoc(effect) or ""
    for word in ("Equation:", "Source:", "Blind:"):
        begins = any(line.strip().startswith(word) for line in text.splitlines())
        require(begins, "documents itself", effect.name, f"no line begins with {word}")
    require(
        len(effect.states) == len(effect.begins) == len(effect.memory),
        "documents itself",
        effect.name,
        "a state without its beginning",
    )
    sizes = {len(s) for s in effect.starts}
    require(
        sizes == {len(effect.params)},
        "documents itself",
        effect.name,
        "a start without a value for each parameter",
    )


LAWS = (
    vanishes_at_its_null,
    every_parameter_matters,
    compiled_equals_numpy,
    looks_only_back,
    its_value_is_found_again,
    it_documents_itself,
)
