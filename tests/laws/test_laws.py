"""Every law on every subject found, and a planted fault for each law to show that it is caught."""

from dataclasses import dataclass, replace

import mujoco
import numpy as np
import pytest

from tests.support.robots import ARM, EVERYTHING
from trueup.chapter.data import PLANT, draw
from trueup.checks import (
    detector_laws,
    dynamics_laws,
    effect_laws,
    family_laws,
    predictor_laws,
    rule_laws,
)
from trueup.checks.law import LawBroken
from trueup.fit.fitter import Fitter
from trueup.fit.free_numbers import Directions
from trueup.fit.randomised import fit_blind, fit_conditioned
from trueup.fit.residual import fit_residual
from trueup.gate.rule import Rule, Verdict, rules
from trueup.model.corrected import Corrected
from trueup.model.dynamics import CompiledFamily, CompiledTree
from trueup.model.effect import Effect, Number, Port, Scale, effects
from trueup.model.family import Family, Param, families
from trueup.model.hypothesis import Hypothesis, Scales, switches
from trueup.model.kinds import KINDS
from trueup.model.mjcf import tree_of
from trueup.model.predictor import Identified, Nominal
from trueup.model.series import Scheme
from trueup.model.tree import FRICTION, JOINT, LINK
from trueup.model.velocity_prior import VelocityPrior
from trueup.monitor.detector import detectors
from trueup.monitor.detectors.quantile import QuantileRun


@pytest.fixture(scope="module")
def predictors():
    data = draw()
    made = [
        Nominal(PLANT),
        Identified(PLANT, (1.2, 0.6, 0.8)),
        fit_blind(PLANT, data.pooled),
        fit_conditioned(PLANT, data.pooled, (1.2, 0.6, 0.8)),
        fit_residual(PLANT, [data.adaptation])[0],
        _corrected(),
    ]
    return {p.kind: p for p in made}


def _corrected():
    fitter = Fitter(
        PLANT.form,
        Directions.of_family(PLANT.dynamics.parameter_names),
        [Scales(0.6, 0.5, 0.7, 1.0)],
        np.ones(2),
    )
    values = fitter.with_effect(fitter.initial_values((1.2, 0.6, 0.8)), "coulomb_friction", (0.2,))
    values = fitter.with_effect(values, "actuator_lag", (0.1,))
    both = Hypothesis() | "coulomb_friction" | "actuator_lag"
    return Corrected(
        PLANT,
        both,
        tuple(map(float, values)),
        Scheme(0.5, 2),
        ((0.5, 0.0, 0.2, 0.6, 0.0, 0.0, 0.0, 0.0), (0.2, 0.0, 0.1, 0.3, 0.0, 0.5, 0.0, 0.1)),
        VelocityPrior(np.array([[0.1, 0.2, 0.3], [0.4, -0.5, 0.6], [-0.7, 0.8, 0.9]]), 2),
    )


@pytest.mark.parametrize("law", effect_laws.LAWS, ids=lambda f: f.__name__)
@pytest.mark.parametrize("name", list(effects()))
def test_effects(law, name):
    law(effects()[name])


class _Vague(Effect):
    """An effect that breaks the laws it can break without being compiled."""

    name = "vague"
    port = Port.FORCE
    category = "structure"
    params = (Number("level", Scale.ACCELERATION), Number("unused", Scale.ONE))
    states = ("z",)
    starts = ((0.1,),)

    @staticmethod
    def apply(a, level):
        return a + level


def test_an_undocumented_effect_is_caught():
    with pytest.raises(LawBroken):
        effect_laws.it_documents_itself(_Vague)


def forget_nulls():
    """The plant keeps its block's nulls; the next one asked works them out anew."""
    vars(effect_laws.PLANT.block).pop("nulls", None)


@pytest.mark.parametrize(
    "law",
    [
        effect_laws.vanishes_at_its_null,
        effect_laws.every_parameter_matters,
        effect_laws.its_value_is_found_again,
    ],
)
def test_an_effect_that_is_not_what_it_says_is_caught(law, monkeypatch):
    """Another effect's numbers in this one's rows: the null is no null, numbers do nothing, values
    are not found."""
    deadband = effects()["deadband"]
    wrong = tuple(replace(n, null=0.3) for n in deadband.params)
    monkeypatch.setattr(deadband, "params", wrong)
    forget_nulls()
    monkeypatch.setattr(
        effect_laws,
        "switches",
        lambda h, joints=1: (
            np.zeros((len(effects()), joints), np.uint8)
            if law is not effect_laws.vanishes_at_its_null
            else switches(h, joints)
        ),
    )
    monkeypatch.setattr(
        "trueup.fit.rollouts.switches",
        lambda h, joints: np.zeros((len(effects()), joints), np.uint8),
    )
    try:
        with pytest.raises(LawBroken):
            law(deadband)
    finally:
        forget_nulls()


def test_an_effect_whose_own_function_is_not_what_was_compiled_is_caught(monkeypatch):
    drag = effects()["quadratic_drag"]
    effect_laws.compiled_equals_numpy(drag)  # which compiles it as it is

    def otherwise(a, v, coefficient):
        return a - 1.001 * coefficient * abs(v) * v

    monkeypatch.setattr(drag, "apply", staticmethod(otherwise))
    with pytest.raises(LawBroken):
        effect_laws.compiled_equals_numpy(drag)


def test_an_effect_that_sees_commands_to_come_is_caught(monkeypatch):
    rolled = effect_laws._rolled

    def foreseeing(values, effect, scheme, commands):
        return rolled(values, effect, scheme, np.roll(commands, -1))

    monkeypatch.setattr(effect_laws, "_rolled", foreseeing)
    with pytest.raises(LawBroken):
        effect_laws.looks_only_back(effects()["coulomb_friction"])


@pytest.mark.parametrize("law", family_laws.LAWS, ids=lambda f: f.__name__)
@pytest.mark.parametrize("name", list(families()))
def test_families(law, name):
    law(families()[name])


def _makers():
    """Each family, and robots from MJCF, with parameters about their own."""
    rng = np.random.default_rng(5)
    for name, family in families().items():
        yield (
            name,
            CompiledFamily(family),
            rng.uniform(0.2, 1.5, (dynamics_laws.VECTORS, len(family.params))),
        )
    for name, text in (("arm", ARM), ("branches and slides", EVERYTHING)):
        tree = tree_of(mujoco, mujoco.MjModel.from_xml_string(text))
        own = np.array(tree.parameters)
        own[LINK * len(tree.joints) + FRICTION :: JOINT] = 0.2
        yield name, CompiledTree(tree), own * rng.uniform(0.95, 1.05, (dynamics_laws.VECTORS, 1))


@pytest.mark.parametrize("law", dynamics_laws.LAWS, ids=lambda f: f.__name__)
@pytest.mark.parametrize(
    ("name", "dynamics", "parameters"),
    list(_makers()),
    ids=lambda x: x if isinstance(x, str) else "",
)
def test_dynamics(law, name, dynamics, parameters):
    law(dynamics, parameters, name)


@pytest.mark.parametrize("law", rule_laws.LAWS, ids=lambda f: f.__name__)
@pytest.mark.parametrize("name", list(rules()))
def test_rules(law, name):
    law(rules()[name]())


@pytest.mark.parametrize("law", predictor_laws.LAWS, ids=lambda f: f.__name__)
@pytest.mark.parametrize("kind", list(KINDS))
def test_predictors(law, kind, predictors):
    law(predictors[kind])


class _Forgetful(Family):
    """A family that breaks every law but that of the compiler."""

    name = "forgetful"
    params = (Param("k", ""), Param("c", "1/s"))

    @staticmethod
    def acceleration(q, v, u, k, c):
        return -k * q

    @staticmethod
    def regressors(q, v, u):
        return q, v


class _TwoFaced(Family):
    """Another text for arrays than for the compiler."""

    name = "two-faced"
    params = (Param("k", "1/s^2"),)

    @staticmethod
    def acceleration(q, v, u, k):
        return -k * q if isinstance(q, float) else k * q

    @staticmethod
    def regressors(q, v, u):
        return (-q,)


@pytest.mark.parametrize("law", family_laws.LAWS, ids=lambda f: f.__name__)
def test_a_planted_fault_in_a_family_is_caught(law):
    with pytest.raises(LawBroken):
        law(_Forgetful)


def test_a_family_that_compiles_to_something_else_is_caught():
    with pytest.raises(LawBroken):
        dynamics_laws.compiled_equals_numpy(
            CompiledFamily(_TwoFaced), np.ones((dynamics_laws.VECTORS, 1)), "two-faced"
        )


class _Restless(CompiledFamily):
    """Dynamics that move in no time, and whose inertia does not resist."""

    def step(self, states, applied, parameters, h_s):
        return super().step(states, applied, parameters, h_s) + 1e-9

    def inertia(self, parameters, q):
        return -super().inertia(parameters, q)


@pytest.mark.parametrize("law", [dynamics_laws.no_time_no_motion, dynamics_laws.inertia_resists])
def test_a_planted_fault_in_dynamics_is_caught(law):
    oscillator = families()["oscillator"]
    parameters = np.ones((dynamics_laws.VECTORS, len(oscillator.params)))
    law(CompiledFamily(oscillator), parameters, "oscillator")
    with pytest.raises(LawBroken):
        law(_Restless(oscillator), parameters, "restless")


@dataclass
class _Moody(Rule):
    calls: int = 0
    name = "moody"

    def __call__(self, trial):
        self.calls += 1
        return Verdict(self.name, self.calls % 2 == 1, 0.0, 0.0, "1", "")


@dataclass
class _Credulous(Rule):
    name = "credulous"

    def __call__(self, trial):
        return Verdict(
            self.name,
            not max(trial.candidate.rollout) > 2 * max(trial.incumbent.rollout),
            0.0,
            0.0,
            "1",
            "",
        )


@dataclass
class _Perverse(Rule):
    name = "perverse"

    def __call__(self, trial):
        return Verdict(
            self.name,
            bool(np.mean(trial.candidate.rollout) > np.mean(trial.incumbent.rollout)),
            0.0,
            0.0,
            "1",
            "",
        )


@dataclass
class _Stubborn(Rule):
    name = "stubborn"

    def __call__(self, trial):
        return Verdict(self.name, False, 0.0, 0.0, "1", "")


@dataclass
class _Inverted(Rule):
    slack: float = 1.0
    require: str = "mean"
    name = "inverted"

    def __call__(self, trial):
        return Verdict(
            self.name,
            bool(self.slack * np.mean(trial.candidate.rollout) <= np.mean(trial.incumbent.rollout)),
            0.0,
            0.0,
            "1",
            "",
        )


@dataclass
class _Bluffing(Rule):
    slack: float = 1.0
    require: str = "mean"
    name = "bluffing"

    def __call__(self, trial):
        return Verdict(self.name, self.require == "bound", 0.0, 0.0, "1", "")


FAULTY_RULES = (_Moody, _Credulous, _Perverse, _Stubborn, _Inverted, _Bluffing)


@pytest.mark.parametrize(("law", "rule"), list(zip(rule_laws.LAWS, FAULTY_RULES, strict=True)))
def test_a_planted_fault_in_a_rule_is_caught(law, rule):
    with pytest.raises(LawBroken):
        law(rule())


@dataclass(frozen=True)
class _Mixing(Nominal):
    def predict_batch(self, states, issued, h_s=None):
        return super().predict_batch(states, issued, h_s) + states.mean()


@dataclass(frozen=True)
class _Scribbling(Nominal):
    def predict_batch(self, states, issued, h_s=None):
        states[:] = super().predict_batch(states, issued, h_s)
        return states


@dataclass(frozen=True)
class _Drifting(Nominal):
    def predict_batch(self, states, issued, h_s=None):
        return super().predict_batch(states, issued, h_s) + 1e-13 * states


@pytest.mark.parametrize(
    ("law", "kind"), list(zip(predictor_laws.LAWS, (_Mixing, _Scribbling, _Drifting), strict=True))
)
def test_a_planted_fault_in_a_predictor_is_caught(law, kind):
    with pytest.raises(LawBroken):
        law(kind(PLANT))


@pytest.fixture(scope="module")
def calibrated():
    return {name: detector_laws.calibrated(kind) for name, kind in detectors().items()}


@pytest.mark.parametrize("law", detector_laws.LAWS, ids=lambda f: f.__name__)
@pytest.mark.parametrize("name", list(detectors()))
def test_detectors(law, name, calibrated):
    law(calibrated[name])


class _Amnesic(QuantileRun):
    name = "forgetful"

    def document(self):
        return {"level": self.level / 2.0, "run": self.run}

    @staticmethod
    def restore(document):
        return _Amnesic(document["level"], document["run"])


class _Late(QuantileRun):
    name = "late"

    def follow(self, state, residuals):
        followed = super().follow(state, residuals)
        return replace(
            followed, alarm=None if followed.alarm is None else len(followed.statistic) - 1
        )


class _Foreseeing(QuantileRun):
    name = "foreseeing"

    def follow(self, state, residuals):
        followed = super().follow(state, residuals)
        return replace(followed, statistic=np.maximum.accumulate(followed.statistic[::-1])[::-1])


class _Nervous(QuantileRun):
    name = "nervous"

    def follow(self, state, residuals):
        return QuantileRun(1.0, self.run).follow(state, residuals)


class _Deaf(QuantileRun):
    name = "deaf"

    def follow(self, state, residuals):
        return QuantileRun(1e9, self.run).follow(state, residuals)


@pytest.mark.parametrize(
    ("law", "kind"),
    list(zip(detector_laws.LAWS, (_Amnesic, _Late, _Foreseeing, _Nervous, _Deaf), strict=True)),
    ids=lambda x: x.__name__,
)
def test_a_planted_fault_in_a_detector_is_caught(law, kind, calibrated):
    healthy = calibrated["quantile_run"]
    with pytest.raises(LawBroken):
        law(kind(healthy.level, healthy.run))
