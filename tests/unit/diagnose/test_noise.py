"""Noise: what the samples alone tell of it, what a model leaves tells, and what is made of it."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.simulated import recorded_twice as recorded
from trueup.diagnose.data_quality import assess
from trueup.diagnose.diagnosis import diagnose
from trueup.diagnose.measure import Gap
from trueup.diagnose.model_selection import Conclusion, agreeing
from trueup.diagnose.noise import Noise, gain, noise_of
from trueup.diagnose.tuning import DATA_QUALITY
from trueup.simulate.noise import NoiseModel

pytestmark = pytest.mark.slow  # whole diagnoses, designs or installations

NOTHING_OUT = np.zeros(4000, bool)


def tracks(law, seed=1):
    drawn = law.drawn(np.random.default_rng(seed), len(NOTHING_OUT), 4)
    return [(column, NOTHING_OUT) for column in 0.3 * drawn.T]


@pytest.mark.parametrize("seed", range(5))
def test_white_noise_is_white(seed):
    found = noise_of(tracks(NoiseModel(), seed))
    assert found.correlation == 0.0
    assert found.sigma == pytest.approx(0.3, rel=0.05)


@pytest.mark.parametrize("correlation", [0.5, 0.7, 0.9])
def test_noise_that_remembers_itself_is_told_with_its_size(correlation):
    found = noise_of(tracks(NoiseModel(correlation)), strides=DATA_QUALITY.residual_strides)
    assert found.correlation == pytest.approx(correlation, abs=0.08)
    assert found.sigma == pytest.approx(0.3, rel=0.2)


def test_outliers_count_in_what_a_model_leaves():
    heavy = tracks(NoiseModel(0.0, 3.0))
    assert noise_of(heavy).sigma < 0.85 * 0.3
    assert noise_of(heavy, smallest=0.995).sigma > noise_of(heavy).sigma * 1.1


def test_a_motion_is_no_noise():
    t = np.arange(4000) * 0.01
    track = np.sin(2.0 * np.pi * t) + 1e-4 * np.random.default_rng(2).normal(size=len(t))
    found = noise_of([(track, NOTHING_OUT)])
    assert found.correlation == 0.0
    assert found.sigma == pytest.approx(1e-4, rel=0.1)


@pytest.mark.parametrize(("correlation", "stride"), [(0.0, 1), (0.6, 1), (0.9, 3)])
def test_the_gain_is_that_of_the_differences(correlation, stride):
    x = NoiseModel(correlation).drawn(np.random.default_rng(3), 200_000, 1)[:, 0]
    n = len(x) - 4 * stride
    fourth = sum(
        w * x[k * stride : k * stride + n] for k, w in enumerate((1.0, -4.0, 6.0, -4.0, 1.0))
    )
    assert np.mean(fourth**2) == pytest.approx(gain(correlation, stride), rel=0.05)


def test_noise_is_drawn_with_its_colour():
    noise = Noise(np.array([0.1, np.nan, 0.2]), np.array([0.9, 0.0, 0.0]))
    drawn = noise.drawn(np.random.default_rng(4), 20_000, np.array([0, 2]))
    assert drawn.std(axis=0) == pytest.approx([0.1, 0.2], rel=0.1)
    lag = [np.corrcoef(x[1:], x[:-1])[0, 1] for x in drawn.T]
    assert lag == pytest.approx([0.9, 0.0], abs=0.03)


@pytest.mark.parametrize("law", [NoiseModel(0.9), NoiseModel(0.0, 3.0), NoiseModel(0.9, 4.0)])
def test_a_friction_is_named_under_noise_that_is_not_white(law):
    plant, episodes, trial = recorded("B1", ["coulomb_friction"], 19, law=law)
    found = diagnose(plant, episodes)
    (entry,) = found.document["effects"]
    assert (found.document["verdict"], entry["effect"]) == ("effect", "coulomb_friction")
    truth = trial.machine.imperfections["coulomb_friction"]["level"]
    assert entry["estimate"]["level"]["value"] == pytest.approx(truth, rel=0.02)
    coloured = any(found.document["evidence"]["noise_correlation"].values())
    assert coloured == bool(law.correlation)
    assert found.gap.after < 1.6 * found.gap.floor


def test_white_noise_stays_white_and_is_measured():
    plant, episodes, trial = recorded("B1", ["coulomb_friction"], 18)
    admission = assess(plant, [e for e in episodes if e.role == "adaptation"])
    assert not admission.correlation.any()
    assert admission.noise == pytest.approx(trial.sigma, rel=0.1)


def test_nothing_is_claimed_against_the_floor():
    plant, episodes, _ = recorded("A1", ["coulomb_friction"], 3)
    choice = replace(diagnose(plant, episodes).choice, verdict=Conclusion.UNKNOWN)
    gap = Gap(
        2.0,
        before=0.1,
        same_numbers=0.1,
        parameters_only=0.05,
        after=0.0101,
        floor=0.01,
        closed=1.0,
        ci95=(0.9, 1.0),
        by_channel={},
    )
    assert agreeing(choice, gap).verdict is Conclusion.EFFECT
    assert agreeing(choice, replace(gap, after=0.02)).verdict is Conclusion.UNKNOWN
    assert agreeing(choice, replace(gap, before=0.009)).verdict is Conclusion.NO_GAP
