"""A topic of a machine that is late beside whatever else acts there."""

from dataclasses import replace

import pytest

from tests.support.simulated import recorded
from tests.support.spoilt import as_recorded
from trueup.diagnose.diagnosis import diagnose

HIDDEN = ["coulomb_friction", "gain_asymmetry"]
MACHINE = {"stage": "physical"}
LATE_S = 0.03


def late(episodes, plant):
    """The same recordings with observations stamped late, as a machine's."""
    machine = [replace(e, conditions=MACHINE) for e in episodes]
    return [replace(as_recorded(plant, e, late_s=LATE_S), conditions=MACHINE) for e in machine]


@pytest.mark.slow
@pytest.mark.parametrize(("tier", "seed"), [("A1", 3), ("B1", 4)])
def test_two_effects_are_named_beside_a_late_topic(tier, seed):
    plant, episodes, _ = recorded(tier, HIDDEN, seed, runs=3)
    document = diagnose(plant, late(episodes, plant)).document
    named = {e["effect"]: e["estimate"] for e in document["effects"]}
    assert set(named) == {"actuator_delay", *HIDDEN}
    assert named["actuator_delay"]["delay"]["value"] == pytest.approx(LATE_S, abs=plant.timestep_s)
    assert document["gap"]["after"] < 0.2 * document["gap"]["parameters_only"]
    assert not {b["effect"] for b in document["excluded"]} & {"actuator_delay", "sensor_delay"}
