"""What recordings can show, before anything is sought."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.simulated import recorded
from trueup.diagnose.diagnosis import diagnose
from trueup.diagnose.identifiability import Shown, identifiability_of
from trueup.episode.role import Role


def of(shown, name):
    rows = {p.parameter: p for p in shown.parameters} | {e.effect: e for e in shown.effects}
    return rows[name]


@pytest.fixture(scope="module")
def lively():
    plant, episodes, _ = recorded("A0", [], 7)
    return plant, episodes


def slow(plant, episodes, size=0.5):
    """Recordings of the same plant whose command takes a minute to change: the position follows it
    at rest, whatever the inertia."""
    t = np.arange(0.0, 60.0, 0.02)
    rng = np.random.default_rng(3)
    k, c, b = plant.parameters
    made = []
    for i, phase in enumerate((0.0, 1.0, 2.0)):
        turn = 2.0 * np.pi * t / 60.0 + phase
        command, rate = size * np.sin(turn), size * np.cos(turn) * 2.0 * np.pi / 60.0
        q, v = c / k * command - b * c / k**2 * rate, c / k * rate
        seen = np.stack([q, v], axis=1) + rng.normal(size=(len(t), 2)) * [1e-3, 1e-2]
        role = Role.VALIDATION if i == 2 else Role.ADAPTATION
        made.append(
            replace(
                episodes[0],
                t_s=t,
                commands=command[:, None],
                observations=seen,
                role=role,
                digest=f"slow-{i}",
            )
        )
    return made


def test_every_number_of_a_well_excited_joint_is_identifiable(lively):
    shown = identifiability_of(*lively)
    assert {p.parameter for p in shown.parameters} == {"k", "c", "b"}
    assert all(p.shown is Shown.IDENTIFIABLE and not p.tied_to for p in shown.parameters)


def test_numbers_of_which_only_ratios_show_are_tied_and_wide(lively):
    plant, episodes = lively
    quick, sluggish = (
        identifiability_of(plant, episodes),
        identifiability_of(plant, slow(plant, episodes)),
    )
    assert of(sluggish, "k").tied_to == ("c", "b")
    assert of(sluggish, "c").tied_to == ("k", "b")
    assert of(sluggish, "k").within > 20.0 * of(quick, "k").within


def test_a_bias_shows_where_a_force_depends_on_the_position_and_nowhere_else(lively):
    free, episodes, _ = recorded("B2", [], 7)
    assert of(identifiability_of(*lively), "sensor_bias").shown is Shown.IDENTIFIABLE
    bias = of(identifiability_of(free, episodes), "sensor_bias")
    assert bias.shown is Shown.NOT
    assert bias.weakest is None
    assert bias.why


@pytest.mark.slow
def test_starts_that_are_held_do_not_make_a_bias_seem_to_show():
    """On a machine's recordings fits hold the starts of windows; a bias moves those, too."""
    free, episodes, _ = recorded("B2", [], 7)
    machine = [replace(e, conditions={"stage": "physical"}) for e in episodes]
    assert of(identifiability_of(free, machine), "sensor_bias").shown is Shown.NOT
    excluded = {b["effect"] for b in diagnose(free, machine).document["excluded"]}
    assert "coulomb_friction" in excluded
    assert "sensor_bias" not in excluded


def test_less_noise_shows_weaker_effects(lively):
    plant, episodes = lively
    rng = np.random.default_rng(1)
    noisy = [
        replace(
            e,
            observations=e.observations
            + rng.normal(size=e.observations.shape) * 0.05 * e.observations.std(axis=0),
        )
        for e in episodes
    ]
    clear, dim = identifiability_of(plant, episodes), identifiability_of(plant, noisy)
    for effect in ("coulomb_friction", "constant_force", "actuator_delay"):
        assert of(dim, effect).weakest > 3.0 * of(clear, effect).weakest


@pytest.mark.slow
def test_the_report_holds_the_table(lively):
    plant, episodes = lively
    document = diagnose(plant, episodes).document["identifiability"]
    before = identifiability_of(plant, episodes).document()
    for rows, name in (("parameters", "parameter"), ("effects", "effect")):
        hidden = [
            {r[name] for r in table[rows] if r["shown"] == "not_identifiable"}
            for table in (document, before)
        ]
        assert hidden[0] == hidden[1]
        assert {r[name] for r in document[rows]} == {r[name] for r in before[rows]}
