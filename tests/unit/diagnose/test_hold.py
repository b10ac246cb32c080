"""What a command does between its samples: declared, or found by what explains the log."""

import json

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.support.case import write_case
from trueup.artifact.artifact import pack, unpack
from trueup.diagnose.case import read_case
from trueup.diagnose.diagnosis import diagnose
from trueup.diagnose.summary_warnings import warnings
from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.errors import BadPlant
from trueup.model.corrected import Corrected
from trueup.model.hypothesis import Hypothesis
from trueup.model.plant import Plant
from trueup.model.series import Scheme, whole

PERIOD_S, SAMPLES = 0.02, 400
TRUTH = {"k": 2500.0, "c": 4.0, "b": 900.0}  # 50 rad/s: six samples in a period


def plant(hold=None, **nominal):
    return Plant.from_document(
        {
            "name": "box",
            "nominal": {
                "family": "oscillator",
                "parameters": {**TRUTH, **nominal},
                "timestep_s": PERIOD_S,
            },
            "commands": [
                {
                    "name": "u",
                    "unit": "V",
                    "limits": [-5.0, 5.0],
                    **({"hold": hold} if hold else {}),
                }
            ],
            "observations": [{"name": "q", "unit": "V"}],
            "evaluation": {"horizon_s": 0.4},
        }
    )


def recorded(hold, seed, role, noise=1e-3):
    """An episode of TRUTH, integrated to nine digits under a ramp, or under steps."""
    rng = np.random.default_rng(seed)
    t = np.arange(SAMPLES) * PERIOD_S
    u = np.convolve(rng.normal(size=SAMPLES + 4), np.ones(5) / 2.2, "valid")
    command = (
        (lambda x: np.interp(x, t, u))
        if hold == "first_order"
        else (lambda x: u[min(int(x / PERIOD_S + 1e-9), SAMPLES - 1)])
    )
    k, c, b = TRUTH.values()
    q = np.zeros(SAMPLES)
    state = np.zeros(2)
    for i in range(SAMPLES - 1):
        q[i] = state[0]
        # the middle of a step that ends where the next begins
        held = command(t[i] + PERIOD_S / 2.0)
        drive = command if hold == "first_order" else (lambda _, held=held: held)
        state = solve_ivp(
            lambda x, y, drive=drive: [y[1], -k * y[0] - c * y[1] + b * drive(x)],
            (t[i], t[i + 1]),
            state,
            rtol=1e-9,
            atol=1e-12,
        ).y[:, -1]
    q[-1] = state[0]
    q += noise * rng.normal(size=SAMPLES)
    made = plant()
    return Episode(t, u[:, None], q[:, None], made.layout, role, {}, 0, f"{hold}-{seed}-{role}")


@pytest.fixture(scope="module", params=["first_order", "zero_order"])
def log(request):
    roles = (Role.ADAPTATION, Role.ADAPTATION, Role.VALIDATION)
    return request.param, [recorded(request.param, i, role) for i, role in enumerate(roles)]


def missed(made, episode, *, ramped):
    model = Corrected(
        made,
        Hypothesis(),
        tuple(float(x) for x in np.concatenate([made.parameters, made.block.nulls[3:]])),
        Scheme(0.5, 16, ramped),
    )
    s = whole(
        made, episode, model.scheme, np.array([0]), np.array([[episode.observations[0, 0], 0.0]])
    )
    return float(
        np.std(
            model._rolled(s, np.array([0.0, 0.0]), Hypothesis())[:, 0] - episode.observations[:, 0]
        )
    )


def test_a_rollout_follows_a_ramp_between_samples():
    episode = recorded("first_order", 7, Role.TEST, noise=0.0)
    stepped, ramped = (missed(plant(), episode, ramped=r) for r in (False, True))
    declared = missed(plant("first_order"), episode, ramped=False)
    assert ramped < 0.02 * np.std(episode.observations)
    assert ramped < 0.2 * stepped
    assert declared == ramped


@pytest.mark.slow
def test_the_hold_that_nobody_declared_is_found(log):
    hold, episodes = log
    report = dict(diagnose(plant(c=6.0), episodes).document)
    entry = report["evidence"]["holds"]["u"]
    assert entry["hold"] == hold
    assert entry["declared"] is False
    assert (entry["ramps_leave"] < 0.5) == (hold == "first_order")
    assert report["verdict"] in ("no_gap", "parameters_only")
    assert report["parameters"]["c"]["value"] == pytest.approx(4.0, rel=0.05)
    told = any("first-order hold" in w for w in warnings(report))
    assert told == (hold == "first_order")


@pytest.mark.slow
def test_a_declared_hold_is_kept(log):
    hold, episodes = log
    entry = diagnose(plant(hold), episodes).document["evidence"]["holds"]["u"]
    assert entry == {"hold": hold, "declared": True, "ramps_leave": None}


def test_a_model_remembers_that_its_commands_are_ramps():
    made = plant()
    values = (*made.parameters, *made.block.nulls[3:])
    model = Corrected(made, Hypothesis(), tuple(map(float, values)), Scheme(0.5, 2, True))
    again = unpack(pack(model, {}))
    assert again.scheme == model.scheme


def test_a_hold_is_one_of_two():
    with pytest.raises(BadPlant) as refused:
        plant("second_order")
    assert refused.value.facts["field"] == "commands[0].hold"


def test_a_ramp_that_is_recorded_more_slowly_has_a_value_at_each_sample(tmp_path):
    slow = plant("first_order")
    episode = recorded("first_order", 3, Role.ADAPTATION)
    write_case(tmp_path, slow, [episode])
    (made, (read,)) = read_case(tmp_path)
    np.testing.assert_allclose(read.commands, episode.commands, atol=1e-12)
    assert json.loads((tmp_path / "plant.json").read_text())["commands"][0]["hold"] == "first_order"
    assert made.layout.commands[0].hold == "first_order"
