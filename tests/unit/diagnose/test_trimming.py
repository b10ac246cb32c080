"""A push from outside is put aside and told; it neither hides what acts nor is taken for it."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.simulated import recorded
from trueup.diagnose.diagnosis import diagnose
from trueup.diagnose.problem_setup import Recordings
from trueup.diagnose.summary_text import sentence
from trueup.diagnose.trimming import Stretch, without
from trueup.episode.role import Role

PUSHED_S = 5.0


def pushed(episode, size):
    """The episode with a push at PUSHED_S, after which the joint swings on from somewhere else."""
    observations = episode.observations.copy()
    after = episode.t_s - PUSHED_S
    kick = np.where(after > 0.0, size * np.sin(9.0 * after) * np.exp(-6.0 * after), 0.0)
    observations += np.column_stack([kick, np.gradient(kick, episode.t_s)])
    return replace(episode, observations=observations)


def of_a_machine(episodes):
    return [replace(e, conditions={"stage": "physical"}) for e in episodes]


@pytest.fixture(scope="module")
def machine():
    plant, episodes, _ = recorded("A", ["coulomb_friction"], 3)
    return plant, of_a_machine(episodes)


@pytest.mark.slow
def test_friction_is_named_though_a_push_hides_it_and_the_push_is_told(machine):
    plant, episodes = machine
    at = next(i for i, e in enumerate(episodes) if e.role is Role.ADAPTATION)
    spread = float(np.std(episodes[at].observations[:, 0]))
    episodes = [pushed(e, 5.0 * spread) if i == at else e for i, e in enumerate(episodes)]
    document = diagnose(plant, episodes).document
    (stretch,) = {s["episode"] for s in document["evidence"]["put_aside"]}
    assert stretch == episodes[at].digest
    begins = min(s["from_s"] for s in document["evidence"]["put_aside"])
    ends = max(s["to_s"] for s in document["evidence"]["put_aside"])
    assert begins <= PUSHED_S < ends
    assert [e["effect"] for e in document["effects"]] == ["coulomb_friction"]
    assert "a push from outside?" in sentence(document)


@pytest.mark.slow
def test_nothing_is_put_aside_where_an_effect_explains_everything(machine):
    plant, episodes = machine
    document = diagnose(plant, episodes).document
    assert document["evidence"]["put_aside"] == []
    assert "push" not in sentence(document)


@pytest.mark.slow
def test_a_stop_that_is_met_in_few_windows_is_no_push():
    plant, episodes, _ = recorded("B1", ["coulomb_friction", "hard_stop"], 2)
    document = diagnose(plant, of_a_machine(episodes)).document
    assert document["evidence"]["put_aside"] == []
    assert {"coulomb_friction", "hard_stop"} == {e["effect"] for e in document["effects"]}


def test_what_is_left_of_an_episode_are_its_parts_before_and_after(machine):
    _, episodes = machine
    episode = episodes[0]
    t_s = episode.t_s
    stretch = Stretch(episode.recording, float(t_s[100]), float(t_s[200]))
    parts = without(episode, [stretch], fewest=16)
    assert [len(p.t_s) for p in parts] == [100, len(t_s) - 200]
    assert parts[1].begins_s == pytest.approx(float(t_s[200]))
    assert np.array_equal(parts[1].observations, episode.observations[200:])


def test_a_part_too_short_to_say_anything_is_left_out_too(machine):
    _, episodes = machine
    episode = episodes[0]
    stretch = Stretch(episode.recording, float(episode.t_s[10]), float(episode.t_s[200]))
    assert [len(p.t_s) for p in without(episode, [stretch], fewest=16)] == [len(episode.t_s) - 200]


def test_other_recordings_stay_as_they_are(machine):
    _, episodes = machine
    stretch = Stretch("another", 0.0, 100.0)
    assert without(episodes[0], [stretch], fewest=16) == [episodes[0]]


def test_recordings_of_which_nothing_would_be_left_are_not_trimmed(machine):
    recordings = Recordings.of(*machine)
    everything = [Stretch(e.recording, 0.0, 1e9) for e in recordings.validation]
    assert recordings.without(everything) is None
    assert recordings.without([]) is None
