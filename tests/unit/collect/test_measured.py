"""What is measured of an episode as it comes in: its conditions, its envelope, what it can tell."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.made import episode_bytes, plant_document
from trueup.collect.measured import measured
from trueup.episode.mcap import read_episode
from trueup.episode.role import Role
from trueup.model.plant import Plant

PLANT = Plant.from_document(plant_document())
WHOLE = {
    "stage": "physical",
    "safeguards": "torque limit",
    "supervisor": "ada",
    "stop_criterion": "|q| > 0.8",
    "excitation": "chirp",
}


def episode(**conditions):
    return read_episode(episode_bytes(1, **conditions), PLANT.layout)


def test_a_whole_declaration_inside_the_envelope_has_no_warning():
    record = measured(PLANT, episode(envelope="as declared", **WHOLE))
    assert record["warnings"] == []
    assert record["conditions"]["missing"] == []
    assert record["excitation"]["rank"] == record["excitation"]["numbers"] == 3
    assert record["excitation"]["condition"] < 30.0


@pytest.mark.parametrize(
    ("conditions", "says"),
    [
        ({}, "the stage is not declared"),
        ({"stage": "lab"}, "the stage 'lab' is none of MIL, SIL, PIL, HIL, physical"),
        ({**WHOLE, "stage": "HIL", "supervisor": None}, "its metadata do not say: supervisor"),
    ],
)
def test_what_is_not_declared_is_said(conditions, says):
    given = {k: v for k, v in conditions.items() if v is not None}
    assert any(says in w for w in measured(PLANT, episode(**given))["warnings"])


def test_a_simulated_episode_needs_no_supervisor():
    assert measured(PLANT, episode(stage="SIL"))["warnings"] == []


def test_breaches_of_the_envelope_are_counted_and_told():
    one = episode(**WHOLE)
    seen = one.observations.copy()
    seen[50:53, 0] = [0.95, 1.4, 0.91]
    record = measured(PLANT, replace(one, observations=seen))
    assert record["envelope"]["breaches"]["q"] == {
        "samples": 3,
        "share": 3 / 200,
        "first_s": pytest.approx(2.5),
        "worst": 1.4,
    }
    assert (
        "q left its envelope [-0.9, 0.9] m in 3 samples, first at 2.5 s, as far as 1.4"
        in record["warnings"]
    )


def test_a_joint_that_hardly_moves_tells_little_and_the_warning_says_so():
    one = episode(**WHOLE)
    still = replace(
        one,
        commands=np.full_like(one.commands, 0.01),
        observations=np.full_like(one.observations, 0.3),
    )
    record = measured(PLANT, still)
    assert record["excitation"]["rank"] < 3
    assert any("hardly moves" in w for w in record["warnings"])
    assert any("of the 3 numbers" in w for w in record["warnings"])
    held_out = measured(PLANT, replace(still, role=Role.VALIDATION))
    assert held_out["warnings"] == []


def test_a_robots_excitation_is_its_command_range_alone(tmp_path):
    from tests.support.robots import arm_plant, recorded

    plant = arm_plant(tmp_path)
    record = measured(
        plant, recorded(plant, lambda _: None, [1], [Role.ADAPTATION], seconds=1.0)[0]
    )
    assert record["excitation"]["rank"] is None
    assert all(0.0 <= part <= 1.0 for part in record["excitation"]["range_used"].values())


def test_a_recording_off_the_declared_step_is_told():
    one = episode(**WHOLE)
    (warning,) = measured(PLANT, replace(one, t_s=1.07 * one.t_s))["warnings"]
    assert warning.startswith("recorded every")
    assert "declare the time step of the recording loop" in warning
