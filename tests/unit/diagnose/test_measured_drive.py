"""A logged effort, and what it says of the drive."""

from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest

from tests.support.made import T0_NS
from tests.support.simulated import recorded
from trueup.diagnose.diagnosis import diagnose
from trueup.diagnose.measured_drive import measured_drives
from trueup.diagnose.problem_setup import Recordings
from trueup.episode.mcap import read_episode
from trueup.episode.writer import write_episode

NOISE = 0.02


@pytest.fixture(scope="module")
def joint():
    plant, episodes, _ = recorded("A1", ["coulomb_friction"], 5, runs=2)
    return plant, episodes


def measured(episodes, drive, late=0):
    """The same recordings with an effort that `drive` makes of the command some samples before."""
    rng, made = np.random.default_rng(2), []
    for e in episodes:
        u = np.roll(e.commands, late, axis=0)
        made.append(replace(e, effort=drive(u) + NOISE * rng.normal(size=u.shape)))
    return made


def test_a_drive_that_follows_its_command_denies_another_gain(joint):
    plant, episodes = joint
    (seen,) = measured_drives(plant, measured(episodes, lambda u: 1.3 * u, late=2))
    assert seen.gain == pytest.approx(1.3, rel=0.01)
    assert seen.late_s == pytest.approx(2 * plant.timestep_s)
    assert set(seen.denied) == {"gain_asymmetry", "quadratic_gain"}


@pytest.mark.parametrize(
    ("drive", "kept"),
    [
        (lambda u: np.where(u > 0.0, 1.2, 0.8) * u, "gain_asymmetry"),
        (lambda u: u * (1.0 - 0.3 * np.abs(u)), "quadratic_gain"),
    ],
)
def test_a_drive_that_has_an_effect_does_not_deny_it(joint, drive, kept):
    plant, episodes = joint
    (seen,) = measured_drives(plant, measured(episodes, drive))
    assert kept not in seen.denied


def test_what_is_no_effort_of_the_drive_says_nothing(joint):
    plant, episodes = joint
    rng = np.random.default_rng(1)
    echo = [replace(e, effort=2.0 * e.commands) for e in episodes]
    other = [replace(e, effort=rng.normal(size=e.commands.shape)) for e in episodes]
    still = [replace(e, effort=np.zeros_like(e.commands)) for e in episodes]
    for logged in (episodes, echo, other, still):
        assert measured_drives(plant, logged) == []


def test_a_denied_effect_is_not_sought_and_the_report_says_why(joint):
    plant, episodes = joint
    seen = measured(episodes, lambda u: u)
    assert "gain_asymmetry" not in Recordings.of(plant, seen).terms
    assert "gain_asymmetry" in Recordings.of(plant, episodes).terms
    document = diagnose(plant, seen).document
    assert [e["effect"] for e in document["effects"]] == ["coulomb_friction"]
    (told,) = document["evidence"]["witnesses"]
    assert {d["effect"] for d in told["denies"]} == {"gain_asymmetry", "quadratic_gain"}


def test_an_effort_on_the_topic_of_the_states_is_read(joint):
    plant, episodes = joint
    (episode, *_) = measured(episodes, lambda u: 1.3 * u)
    stream = BytesIO()
    write_episode(
        stream,
        stamps_ns=T0_NS + np.rint(1e9 * episode.t_s).astype(np.int64),
        observations=episode.observations,
        commands=episode.commands,
        layout=plant.layout,
        role=episode.role,
        conditions=episode.conditions,
        effort=episode.effort,
    )
    again = read_episode(stream.getvalue(), plant.layout)
    assert np.array_equal(again.effort, episode.effort)
    assert np.array_equal(again.observations, episode.observations)
    assert np.array_equal(again.part(5, 50).effort, episode.effort[5:50])
