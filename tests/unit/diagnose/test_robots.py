"""A robot's gap is found at its joint: one effect, a payload, and what of it an experiment or another rollout can use."""

import json

import numpy as np
import pytest

from tests.support.robots import arm_plant, recorded
from trueup.artifact.artifact import pack, unpack
from trueup.diagnose.diagnosis import diagnose
from trueup.diagnose.locate import Strides, _pushed
from trueup.diagnose.page import page, pushed, sentence
from trueup.fit.base_parameters import directions
from trueup.fit.identify import identify
from trueup.fit.residual import fit_residual
from trueup.model.predictor import Nominal, predict_observations
from trueup.model.windows import cut, starts_every

ROLES = ("adaptation", "adaptation", "adaptation", "validation", "validation")


def rubs(spec):
    spec.joint("elbow").frictionloss = 0.25


def carries(spec):
    spec.body("lower").add_geom(type=2, size=[0.03, 0, 0], pos=[0.3, 0, 0], mass=0.4, contype=0, conaffinity=0)


@pytest.fixture(scope="module")
def plant(tmp_path_factory):
    return arm_plant(tmp_path_factory.mktemp("arm"))


@pytest.fixture(scope="module")
def rubbing(plant):
    episodes = recorded(plant, rubs, range(5), ROLES)
    return episodes, diagnose(plant, episodes)


def test_the_effect_and_its_joint_are_named(rubbing):
    document = rubbing[1].document
    assert document["verdict"] == "effect"
    named = {(e["effect"], e["joint"]) for e in document["effects"]}
    assert named == {("coulomb_friction", "elbow")}
    level = document["effects"][0]["estimate"]["level"]
    assert level["unit"] == "N·m"
    assert level["value"] == pytest.approx(0.25, rel=0.05)


def test_the_gap_lies_where_the_joint_is_and_not_where_it_travels(rubbing):
    where = rubbing[1].document["where"]
    shares = {entry["joint"]: entry for entry in where["joints"]}
    assert shares["elbow"]["force"] > 0.8
    assert shares["elbow"]["force"] > shares["elbow"]["acceleration"]
    assert where["regions_of"] == "elbow"


def test_the_gap_closes_on_held_out_episodes(rubbing):
    gap = rubbing[1].document["gap"]
    assert gap["closed"] > 0.95
    assert gap["after"] < 0.2 * gap["before"]


def test_the_corrected_model_is_an_artifact_that_predicts_the_same(rubbing):
    episodes, found = rubbing
    again = unpack(pack(found.predictor, {"origin": "diagnosis"}))
    windows = cut(found.plant, episodes[-1], starts_every(episodes[-1].t_s, 0.5))
    np.testing.assert_array_equal(predict_observations(again, windows), predict_observations(found.predictor, windows))


def test_report_and_page_name_the_joint(rubbing):
    found = rubbing[1]
    json.dumps(found.document, allow_nan=False)
    assert "coulomb friction at elbow" in sentence(found.document).lower()
    assert "elbow" in page(found)
    assert all("joint" in bound for bound in found.document["excluded"])


def test_a_payload_is_parameters_only(plant):
    document = diagnose(plant, recorded(plant, carries, range(5), ROLES)).document
    assert document["verdict"] == "parameters_only"
    assert document["effects"] == []
    assert document["gap"]["closed"] > 0.95


def test_what_the_motion_cannot_show_is_not_numbered(plant, rubbing):
    shown = directions(plant, [e for e in rubbing[0] if e.role == "adaptation"])
    determined = {n for n, d in zip(plant.dynamics.parameter_names, shown.determined, strict=True) if d}
    assert "damping(elbow)" in determined
    assert not determined & {"mass(shoulder)", "Ixx(shoulder)", "Ixy(lower)", "gain(shoulder)"}
    assert set(rubbing[1].document["parameters"]) == determined


def test_identified_and_residual_predict_a_payload_better_than_the_nominal_model(plant):
    episodes = recorded(plant, carries, range(4), (*ROLES[:3], "validation"))
    adaptation, test = episodes[:3], episodes[3]
    windows = cut(plant, test, starts_every(test.t_s, 0.5))

    def error(predictor):
        return float(np.sqrt(np.mean((predict_observations(predictor, windows) - test.observations[windows.rows])[windows.inside] ** 2)))

    found, report = identify(plant, adaptation)
    assert report.health == ()
    assert error(found) < 0.1 * error(Nominal(plant))
    assert error(fit_residual(plant, adaptation)[0]) < error(Nominal(plant))


def leaned_on(plant, episodes, from_s, to_s):
    """Strides of a tenth of a second in which the elbow is pushed for a while, and the shoulder jerks now to one side, now to the other."""
    rng, count = np.random.default_rng(0), 40
    t = (np.arange(count) + 0.5) * 0.1
    residual = np.concatenate([rng.normal(size=(count, 2)) for _ in episodes])
    residual[:count, 1] -= 20.0 * ((t > from_s) & (t < to_s))
    residual[:count, 0] += 20.0 * np.where(np.arange(count) % 8 < 4, 1.0, -1.0) * (t > 2.0)
    many, one = np.ones_like(residual), np.ones(len(residual))
    at = np.concatenate([t / e.t_s[-1] for e in episodes])
    which = np.repeat(np.arange(len(episodes)), count)
    return Strides(residual, residual, many, many, many, many, at, many, many > 0.0, which, 0.1 * one)


def test_something_that_leans_on_a_joint_is_told_with_its_time(plant):
    episodes = recorded(plant, lambda _spec: None, (0, 1), ("adaptation", "validation"))
    (push,) = _pushed(plant, leaned_on(plant, episodes, 1.0, 2.2), episodes)
    assert push["episode"] == episodes[0].digest
    assert [j["joint"] for j in push["joints"]] == ["elbow"]
    assert push["from_s"] == pytest.approx(1.0)
    assert push["to_s"] == pytest.approx(2.2)
    assert push["joints"][0]["force"] < -15.0
    assert _pushed(plant, leaned_on(plant, episodes, 1.0, 1.5), episodes) == []
    roles = [{"sha256": e.digest, "role": str(e.role)} for e in episodes]
    (words,) = pushed({"where": {"pushed": [push]}, "evidence": {"episodes": roles}})
    assert "1 to 2.2 s: elbow by -2" in words
