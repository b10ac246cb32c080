"""Monitors of robots: every joint's channels under one promise, and the joint is named."""

import pytest

from tests.support.robots import arm_plant, recorded
from trueup.episode.role import Role
from trueup.model.predictor import Nominal
from trueup.monitor.monitor import calibrate

pytestmark = pytest.mark.slow  # whole diagnoses, designs or installations

KINDS = ("likelihood_ratio_cusum", "effect_cusum")


@pytest.fixture(scope="module")
def plant(tmp_path_factory):
    return arm_plant(tmp_path_factory.mktemp("arm"))


def rubbing(spec):
    spec.joints[0].frictionloss = 0.3


def test_friction_at_one_joint_is_found_and_the_joint_is_named(plant):
    reference = recorded(plant, lambda _: None, range(24), [Role.REFERENCE] * 24, 3.0)
    monitor = calibrate(Nominal(plant), "served", reference, 2.0, kinds=KINDS)
    state = monitor.begin()
    for episode in recorded(plant, lambda _: None, range(100, 103), [Role.REFERENCE] * 3, 3.0):
        state, seen = monitor.follow(state, Nominal(plant), episode)
        assert seen.alarms == {}
    leading = []
    for episode in recorded(plant, rubbing, range(200, 203), [Role.REFERENCE] * 3, 3.0):
        state, seen = monitor.follow(state, Nominal(plant), episode)
        leading += [words for _, words in seen.alarms.values()]
    assert len(leading) >= 3
    assert all("shoulder" in words for words in leading), leading
