"""Machines that others recorded: what is known of them is said, and what happened to one of them
once is not taken for a law."""

from pathlib import Path

from trueup.diagnose.case import read_case
from trueup.diagnose.diagnosis import diagnose
from trueup.diagnose.summary_text import sentence

REAL = Path(__file__).parent.parent / "real"
NO_LOAD_SPEED = 7.87  # rad/s, of the servo by its manufacturer
MET_SOMETHING_S = 1.2  # in the recording


def test_a_servo_is_as_fast_as_its_manufacturer_says():
    document = diagnose(*read_case(REAL / "sts3250")).document
    (effect,) = document["effects"]
    low, high = effect["estimate"]["rate"]["ci95"]
    assert effect["effect"] == "rate_limit"
    assert document["indistinguishable"] == []
    assert low < NO_LOAD_SPEED < high
    (rate,) = (b for b in document["between_recordings"] if b["parameter"] == "rate")
    assert rate["widens"]  # one recording hardly reaches that speed, and says less
    together = rate["together"]
    assert low < together[0] < NO_LOAD_SPEED < together[1] < high
    assert together[1] - together[0] < 0.2 * NO_LOAD_SPEED
    assert document["gap"]["after"] < 0.25 * document["gap"]["parameters_only"]


def test_what_a_pendulum_met_once_is_left_out_and_the_rest_is_predicted_better():
    plant, episodes = read_case(REAL / "simple-pendulum")
    document = diagnose(plant, episodes).document
    (stretch,) = document["evidence"]["put_aside"]
    assert stretch["episode"] == episodes[1].digest
    assert stretch["from_s"] < MET_SOMETHING_S < stretch["to_s"]
    assert document["gap"]["after"] < 0.7 * document["gap"]["before"]
    assert "no effect explains what happened there" in sentence(document)
