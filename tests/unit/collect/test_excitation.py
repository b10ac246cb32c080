"""Designed excitations: bounded, safe under every model still in play, ending at rest, and worth more than a random one."""

import json

import numpy as np
import pytest

from tests.support.made import TRUE, plant_document
from trueup.collect.bounds import Bounds
from trueup.collect.ensemble import Ensemble, InPlay
from trueup.collect.excitation import Setting, at_rest, identification
from trueup.collect.wave import AT_REST
from trueup.diagnose.diagnosis import diagnose
from trueup.episode.mcap import read_episode
from trueup.errors import NotAnEpisode, NotIdentifiable
from trueup.model.plant import Plant
from trueup_cli.excite import excite

DOCUMENT = {
    **plant_document(),
    "nominal": {"family": "oscillator", "parameters": dict(zip("kcb", TRUE, strict=True)), "timestep_s": 0.05},
}
PLANT = Plant.from_document(DOCUMENT)
NOISE = np.array([0.01, 0.02])


def designed(plant=PLANT, spread=0.02, seed=0, duration_s=8.0, **bounds):
    chosen = {"band_hz": None, "rate": None, "margin": 0.1, **bounds}
    ensemble = Ensemble.prior(plant, spread)
    setting = Setting(InPlay((ensemble,)), Bounds.of(plant, duration_s, **chosen), NOISE, np.zeros(2), np.zeros(1))
    return identification(setting, np.random.default_rng(seed), effort=0.2)


@pytest.fixture(scope="module")
def found():
    return designed()


def test_it_stays_inside_the_envelope_with_its_margin_under_a_thousand_models(found):
    assert found.breaches == 0
    assert found.paths.shape[0] == 1000
    assert np.abs(found.paths[:, :, 0]).max() <= 0.9 * 0.9 + 1e-12
    assert 0.6 < found.used <= 0.9  # and it uses what it is given


def test_it_is_bounded_in_command_and_rate_and_returns_to_rest(found):
    step = np.abs(np.diff(found.command[:, 0]))
    assert np.abs(found.command).max() <= 1.0
    assert step.max() <= found.bounds.rate[0] * 0.05 + 1e-12
    assert found.command[0] == found.command[-1] == 0.0
    speed = np.abs(found.paths[:, :, 1])
    assert speed[:, -1].max() <= 1.5 * AT_REST * speed.max()  # members drawn anew end a little faster than those it was made for


def test_it_tells_every_number_better_than_a_random_one_of_the_same_energy(found):
    assert found.information.rank == 3
    assert found.information.condition < 10.0
    for name, width in found.information.half_widths.items():
        assert width < found.random.half_widths[name]


def test_the_same_seed_gives_the_same_excitation(found):
    assert np.array_equal(designed().command, found.command)


def test_a_slower_drive_and_a_narrower_envelope_are_kept():
    narrow = Plant.from_document({**DOCUMENT, "envelope": {"q": [-0.2, 0.2]}})
    made = designed(narrow, rate=2.0, duration_s=6.0)
    assert np.abs(made.paths[:, :, 0]).max() <= 0.18 + 1e-12
    assert np.abs(np.diff(made.command[:, 0])).max() <= 0.1 + 1e-12


def test_without_an_envelope_the_command_limits_alone_bind():
    free = Plant.from_document({k: v for k, v in DOCUMENT.items() if k != "envelope"})
    made = designed(free, duration_s=6.0)
    narrow = designed(Plant.from_document({**DOCUMENT, "envelope": {"q": [-0.3, 0.3]}}), duration_s=6.0)
    assert made.document()["envelope_used"] is None
    assert made.information.half_widths["k"] < narrow.information.half_widths["k"]


def test_a_machine_that_never_rests_is_refused_and_told_what_to_do():
    document = {**plant_document(), "nominal": {"family": "oscillator", "parameters": {"k": 1.0, "c": -0.1, "b": 1.0}, "timestep_s": 0.05}}
    plant = Plant.from_document(document)
    with pytest.raises(NotIdentifiable, match="does not come to rest") as refused:
        at_rest(Ensemble.prior(plant, 0.1), np.array([0.1, 0.0]), np.zeros(1))
    assert "controller" in refused.value.hint


def test_rest_is_where_the_machine_hangs():
    pendulum = Plant.from_document(
        {**plant_document(), "nominal": {"family": "pendulum", "parameters": {"k": 4.0, "c": 1.0, "b": 1.0}, "timestep_s": 0.05}}
    )
    rest = at_rest(Ensemble.prior(pendulum, 0.1), np.zeros(2), np.array([2.0]))
    assert rest == pytest.approx([np.arcsin(0.5), 0.0], abs=1e-6)


def test_the_ensemble_of_a_diagnosis_is_as_uncertain_as_its_report():
    from tests.support.simulated import recorded

    plant, episodes, _ = recorded("A1", ["coulomb_friction"], 3)
    diagnosis = diagnose(plant, episodes)
    ensemble = Ensemble.posterior(diagnosis.predictor, diagnosis.document)
    assert {"k", "c", "b", "coulomb_friction level"} <= set(ensemble.names)
    low, high = diagnosis.document["parameters"]["k"]["ci95"]
    drawn = ensemble.drawn(2000, np.random.default_rng(0))[ensemble.rows[ensemble.names.index("k")]]
    assert np.quantile(drawn, [0.025, 0.975]) == pytest.approx([low, high], rel=0.02)
    level = ensemble.drawn(200, np.random.default_rng(1))[ensemble.rows[ensemble.names.index("coulomb_friction level")]]
    assert (level > 0.0).all()


def test_the_command_writes_what_a_robot_plays_and_no_episode(tmp_path, capsys):
    (tmp_path / "plant.json").write_text(json.dumps(plant_document()))
    excite(tmp_path, out=tmp_path / "out", spread=0.1, duration_s=6.0)
    document = json.loads((tmp_path / "out" / "excitation.json").read_text())
    rows = (tmp_path / "out" / "excitation.csv").read_text().splitlines()
    assert rows[0] == "t,u"
    assert len(rows) == document["samples"] + 1
    assert (document["breaches"], document["information"]["rank"]) == (0, 3)
    assert (tmp_path / "out" / "excitation.svg").read_text().startswith("<svg")
    with pytest.raises(NotAnEpisode):
        read_episode((tmp_path / "out" / "excitation.mcap").read_bytes(), PLANT.layout)
    assert "designed" in capsys.readouterr().out
