"""Diagnosis beside peers and house baselines, on machines of the second simulator, all in one run.

Peers run in an environment of their own under bench/.peers, made at first use; none is a dependency
of trueup. They are helped: they are given the family's own terms and the terms of six effects that
a linear regression can express, are told whether one or two effects are hidden, and are credited
for their largest further term; trueup is told nothing. `expressible` counts only machines with one
of those six. Every method predicts the same positions from the same samples, over windows of a
horizon.
"""

from __future__ import annotations

import ast
import json
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.peers.case import TERMS
from bench.peers.environment import HERE, run_peer
from tests.support.simulated import episode_of, episodes_of, plant_of
from trueup.blindtrial.scoring import Answer, score_answer
from trueup.diagnose.data_quality import assess
from trueup.diagnose.diagnosis import diagnose
from trueup.diagnose.explore import explore
from trueup.diagnose.filtering import corrected
from trueup.diagnose.indistinguishable import aliases
from trueup.diagnose.model_selection import penalised
from trueup.diagnose.problem_setup import Recordings
from trueup.episode.role import Role
from trueup.model.effect import effects
from trueup.model.hypothesis import Hypothesis
from trueup.model.predictor import Nominal
from trueup.model.windows import cut, starts_every
from trueup.simulate.machine import BEYOND
from trueup.simulate.trial import CATALOGUE, draw, draw_bench

TIERS = ("A1", "B1", "B2")
# nothing there shows them
ON_INERTIA = "sensor_bias", "sensor_drift", "k_modulated", "asymmetric_stiffness"
PAIRS, NONE, OUTSIDE = 6, 6, 6
SEED = 20260
HORIZON_S = 1.0
METHODS = {
    "PySINDy (STLSQ)": "sindy",
    "SysIdentPy (FROLS, NARMAX)": "narmax",
    "least squares + BIC, forward": "least_squares",
    "black-box residual (MLP)": "black_box",
}


CANNOT_NAME = ("narmax", "black_box")


@dataclass(frozen=True)
class Hidden:
    """One machine: what a method is given, and what is hidden."""

    name: str
    plant: object
    episodes: list
    tests: list
    label: dict


@dataclass(frozen=True)
class Given:
    """A method's answer: what it names, whether it abstains, its positions on the test recordings,
    how long it took."""

    answer: Answer
    positions: np.ndarray
    seconds: float


def machines() -> list[Hidden]:
    """Every effect of the catalogue once, then pairs, machines without effects, and machines beyond
    the catalogue."""
    rng = np.random.default_rng(SEED)
    wanted = [("single", [name]) for name in CATALOGUE]
    wanted += [
        ("pair", [str(n) for n in rng.choice(CATALOGUE[:-2], 2, replace=False)])
        for _ in range(PAIRS)
    ]
    wanted += [("none", [])] * NONE + [
        ("outside", [str(n)]) for n in rng.permutation(BEYOND)[:OUTSIDE]
    ]
    found = []
    for i, (kind, names) in enumerate(wanted):
        tier = TIERS[i % 3] if not set(names) & set(ON_INERTIA) else TIERS[i % 2]
        bench = draw_bench(tier, rng)
        trial = draw(bench, names, True, rng)
        document = dict(plant_of(bench).document) | {"evaluation": {"horizon_s": HORIZON_S}}
        plant = type(plant_of(bench)).from_document(document)
        tests = [
            episode_of(plant, run, Role.TEST, f"test-{j}") for j, run in enumerate(trial.of("test"))
        ]
        label = {"kind": kind, "effects": {n: {} for n in names}, "moved": True, "bait": None}
        found.append(Hidden(f"{i:03d}", plant, episodes_of(plant, trial), tests, label))
    return found


def positions(predictor, tests) -> np.ndarray:
    """Predicted positions of all test recordings, one after another."""
    parts = []
    for e in tests:
        window = round(HORIZON_S / e.period_s)
        w = cut(predictor.plant, e, starts_every(e.t_s[:-1], HORIZON_S - 1e-9, 0.0))
        with np.errstate(over="ignore", invalid="ignore"):
            parts.append(np.asarray(predictor.rollout(w)[w.inside])[: len(e.t_s), 0])
        assert len(parts[-1]) >= len(e.t_s) - window
        parts[-1] = np.r_[parts[-1], e.observations[len(parts[-1]) :, 0]]
    return np.concatenate(parts)


def house(machine: Hidden) -> dict[str, Given]:
    """Trueup, and what the same fits answer by simpler rules."""
    plant, adaptation = machine.plant, [e for e in machine.episodes if e.role is Role.ADAPTATION]
    validation = [e for e in machine.episodes if e.role is Role.VALIDATION]
    began = time.monotonic()
    found = diagnose(plant, machine.episodes)
    took = time.monotonic() - began
    given = {
        "trueup": Given(
            Answer(dict(found.document), None, took),
            positions(found.predictor, machine.tests),
            took,
        )
    }
    began = time.monotonic()
    recordings = Recordings.of(plant, [*adaptation, *validation])
    explored = explore(recordings, assess(plant, adaptation), lambda *_: None)
    search, quality = explored.search, explored.searched.quality
    took = time.monotonic() - began
    candidates = [c for c in search if np.isfinite(c.total)]
    spread = max(min(c.total for c in candidates), 0.5)
    counted = [e["effect"] for e in found.document["effects"] if effects()[e["effect"]].counted]
    rules = {
        "BIC on our fits": min(candidates, key=lambda c: penalised(c, spread)),
        "lowest held-out error": min(candidates, key=lambda c: c.reduced_chi_square),
        "always Coulomb": search.candidates[Hypothesis(("coulomb_friction",))],
    }
    for name, c in rules.items():
        predictor = corrected(plant, quality, c.fit, search.problem.scheme, adaptation)
        names = [*c.hypothesis.effects, *counted]
        # no rule could part them: each is credited
        others = [
            [*c.hypothesis.without(e).effects, alias, *counted]
            for e, alias in aliases(c.hypothesis)
        ]
        given[name] = Given(_named(names, others), positions(predictor, machine.tests), took)
    return given


def _named(names, others=()) -> Answer:
    verdict = "effect" if names else "parameters_only"
    return Answer(
        {
            "verdict": verdict,
            "effects": [{"effect": e} for e in names],
            "indistinguishable": list(others),
        },
        None,
        0.0,
    )


def peers(found: list[Hidden]) -> dict[str, dict[str, Given]]:
    """Every peer's answers, by method and machine."""
    given = {}
    with tempfile.TemporaryDirectory() as temporary:
        cases = Path(temporary) / "cases"
        cases.mkdir()
        for m in found:
            _write(cases / f"{m.name}.npz", m)
        for method, module in METHODS.items():
            out = Path(temporary) / module
            print(f"{method} …", flush=True)
            run_peer(module, cases, out)
            answers = {m.name: json.loads((out / f"{m.name}.json").read_text()) for m in found}
            given[method] = {
                name: Given(_named(a["named"]), np.load(out / f"{name}.npy"), a["seconds"])
                for name, a in answers.items()
            }
    return given


def _write(file: Path, m: Hidden) -> None:
    plant, arrays, about = m.plant, {}, {}
    groups = {
        role: [e for e in m.episodes if e.role == role] for role in ("adaptation", "validation")
    } | {"test": m.tests}
    for role, episodes in groups.items():
        about[role] = len(episodes)
        for i, e in enumerate(episodes):
            arrays |= {
                f"{role}{i}t": e.t_s,
                f"{role}{i}u": plant.applied(e.commands)[:, 0],
                f"{role}{i}y": e.observations,
            }
    about |= {
        "family": plant.family,
        "parameters": dict(plant.nominal),
        "dt": m.tests[0].period_s,
        "window": round(HORIZON_S / m.tests[0].period_s),
        "hidden": len(m.label["effects"]),
    }
    np.savez(file, about=json.dumps(about), **arrays)


def closed(m: Hidden, predicted: np.ndarray) -> float:
    """The part of the nominal model's gap in position that is closed on the test recordings."""
    seen = np.concatenate([e.observations[:, 0] for e in m.tests])
    noise = assess(m.plant, [e for e in m.episodes if e.role is Role.ADAPTATION]).noise[0] ** 2
    before = float(np.mean((positions(Nominal(m.plant), m.tests) - seen) ** 2))
    with np.errstate(over="ignore", invalid="ignore"):
        after = float(np.mean((predicted - seen) ** 2))
    part = 1.0 - (after - noise) / (before - noise)
    return float(np.clip(part, -1.0, 1.0)) if np.isfinite(part) else -1.0


def main() -> None:
    """Print the table, and what each method was given."""
    found = machines()
    print(
        (
            f"{len(found)} machines: {len(CATALOGUE)} with one effect, {PAIRS} with two, {NONE} "
            f"with none, {OUTSIDE} beyond the catalogue"
        ),
        flush=True,
    )
    given: dict[str, dict[str, Given]] = {}
    for m in found:
        for method, answer in house(m).items():
            given.setdefault(method, {})[m.name] = answer
        print(
            (
                f"  {m.name} {' + '.join(m.label['effects']) or 'none'}: "
                f"{given['trueup'][m.name].seconds:.1f} s"
            ),
            flush=True,
        )
    given |= peers(found)
    print("\n" + __doc__.split("\n\n", 1)[1])
    for module in METHODS.values():
        about = ast.get_docstring(ast.parse((HERE / "peers" / f"{module}.py").read_text()))
        print(f"  {module}: {about}\n")
    columns = (
        "one effect",
        "expressible",
        "two",
        "none",
        "beyond",
        "closed median",
        "worst tenth",
        "s, median",
    )
    print(f"{'':<30}" + "".join(f"{c:>15}" for c in columns))
    table = {}
    for method, answers in given.items():
        table[method] = _line(found, answers)
        if METHODS.get(method) in CANNOT_NAME:
            table[method][:5] = ["cannot"] * 5
        print(f"{method:<30}" + "".join(f"{x:>15}" for x in table[method]), flush=True)
    results = HERE / "results"
    results.mkdir(exist_ok=True)
    (results / "diagnosis.json").write_text(
        json.dumps({"columns": columns, "methods": table}, indent=1)
    )


def _line(found: list[Hidden], answers: dict[str, Given]) -> list[str]:
    exact = {m.name: bool(score_answer(m.label, answers[m.name].answer)["exact"]) for m in found}

    def share(chosen) -> str:
        return f"{sum(exact[m.name] for m in chosen)}/{len(chosen)}"

    kinds = {
        k: [m for m in found if m.label["kind"] == k] for k in ("single", "pair", "none", "outside")
    }
    expressible = [m for m in kinds["single"] if set(m.label["effects"]) <= set(TERMS)]
    parts = [closed(m, answers[m.name].positions) for m in [*kinds["single"], *kinds["pair"]]]
    seconds = float(np.median([a.seconds for a in answers.values()]))
    return [
        share(kinds["single"]), share(expressible), share(kinds["pair"]), share(kinds["none"]),
        share(kinds["outside"]),
        f"{np.median(parts):.4f}", f"{np.quantile(parts, 0.1):.3f}", f"{seconds:.2f}",
    ]  # fmt: skip


if __name__ == "__main__":
    main()
