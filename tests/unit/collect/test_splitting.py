"""Experiments that split what a diagnosis left: the alternatives stand in its report, and the
machine's answer parts them."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.support.made import TRUE, plant_document
from tests.support.simulated import episode_of, episodes_of, plant_of
from trueup.collect.bounds import Bounds
from trueup.collect.ensemble import Ensemble, InPlay
from trueup.collect.excitation import Setting, splitting
from trueup.collect.goal import SplittingGoal
from trueup.diagnose.diagnosis import diagnose
from trueup.episode.role import Role
from trueup.errors import NotIdentifiable
from trueup.model.corrected import Corrected
from trueup.model.hypothesis import Hypothesis
from trueup.model.plant import Plant
from trueup.model.series import refined
from trueup.simulate.machine import run
from trueup.simulate.trial import draw, draw_bench
from trueup_cli.diagnose import write
from trueup_cli.excite import excite

pytestmark = pytest.mark.slow  # whole diagnoses, designs or installations


@pytest.fixture(scope="module")
def undecided():
    """A saturation in recordings so short and noisy that heat explains them as well."""
    rng = np.random.default_rng(109)
    bench = replace(draw_bench("A1", rng), duration_s=3.0, noise=0.05)
    trial = draw(bench, ["saturation"], True, rng, gaps=(0.1, 0.3))
    plant = plant_of(bench)
    episodes = episodes_of(plant, trial)
    return plant, bench, trial, episodes, diagnose(plant, episodes)


@pytest.fixture(scope="module")
def designed(undecided):
    plant, _, trial, _, diagnosis = undecided
    play = InPlay(
        (
            Ensemble.posterior(diagnosis.predictor, diagnosis.document),
            *Ensemble.alternatives(plant, diagnosis.document),
        )
    )
    bounds = Bounds.of(plant, 6.0)
    return splitting(
        Setting(play, bounds, trial.sigma, np.zeros(2), np.zeros(1)),
        np.random.default_rng(0),
        effort=0.1,
    )


def test_the_report_holds_every_alternative_as_it_was_fitted(undecided):
    plant, _, _, _, diagnosis = undecided
    assert diagnosis.document["indistinguishable"] == [["thermal_derating"]]
    (left,) = Ensemble.alternatives(plant, json.loads(json.dumps(diagnosis.document)))
    (rival,) = diagnosis.choice.rivals
    assert left.hypothesis == rival.hypothesis
    assert left.centre == pytest.approx(rival.fit.values)
    assert {"k", "c", "b", "thermal_derating loss"} <= set(left.names)


def test_it_parts_the_alternatives_better_than_a_random_one_and_is_safe_under_both(
    undecided, designed
):
    plant = undecided[0]
    assert designed.information.alternatives == (("thermal_derating",),)
    assert designed.information.least > 1.2 * designed.random.information.least
    assert (len(designed.paths), designed.breaches) == (1000, 0)
    low, high = plant.envelope["q"]
    assert low < designed.paths[:, :, 0].min() < designed.paths[:, :, 0].max() < high
    assert designed.document()["information"]["separation"][0]["from"] == ["thermal_derating"]


def test_what_the_machine_answers_leaves_one_explanation(undecided, designed):
    plant, bench, trial, episodes, _ = undecided
    rng = np.random.default_rng(1)
    more = [
        episode_of(
            plant,
            run(
                trial.machine,
                designed.command[:, 0],
                bench.timestep_s,
                bench.parts,
                tuple(trial.sigma),
                rng,
            ),
            role,
            role,
        )
        for role in (Role.ADAPTATION, Role.VALIDATION)
    ]
    diagnosis = diagnose(plant, [*episodes, *more])
    assert [e["effect"] for e in diagnosis.document["effects"]] == ["saturation"]
    assert diagnosis.document["indistinguishable"] == []


def test_without_alternatives_there_is_nothing_to_split(undecided, tmp_path):
    plant, _, _, episodes, result = undecided
    (tmp_path / "plant.json").write_text(json.dumps(plant.document))
    with pytest.raises(NotIdentifiable, match="without a diagnosis") as refused:
        excite(str(tmp_path), out=tmp_path / "out", split=True)
    assert "--model" in refused.value.hint
    write(result, episodes, tmp_path / "found", {})
    report = json.loads((tmp_path / "found" / "report.json").read_text())
    report["evidence"]["alternatives"] = []
    report["next_experiment"] = {"why": "No command parts them: log the motor current."}
    (tmp_path / "found" / "report.json").write_text(json.dumps(report))
    with pytest.raises(NotIdentifiable, match="left no alternatives") as refused:
        excite(str(tmp_path), out=tmp_path / "out", model=str(tmp_path / "found"), split=True)
    assert "motor current" in refused.value.hint


def test_the_command_writes_the_experiment(undecided, tmp_path, capsys, monkeypatch):
    plant, _, _, episodes, result = undecided
    monkeypatch.setattr("trueup.collect.excitation.TRIED", 8)
    monkeypatch.setattr("trueup.collect.excitation.IMPROVED", 4)
    (tmp_path / "plant.json").write_text(json.dumps(plant.document))
    write(result, episodes, tmp_path / "found", {})
    excite(
        str(tmp_path),
        out=tmp_path / "out",
        model=str(tmp_path / "found"),
        split=True,
        duration_s=10.0,
    )
    document = json.loads((tmp_path / "out" / "excitation.json").read_text())
    assert document["goal"] == "split"
    # of the noise that the diagnosis result
    assert 4.0 < document["information"]["separation"][0]["standard_errors"] < 200.0
    assert "thermal_derating" in capsys.readouterr().out


def ensemble(plant, parameters, wide=(0.02, 0.02, 0.02), **effects):
    """A composition with its numbers known to a few hundredths."""
    values, hypothesis, rows, sizes = plant.block.nulls.copy(), Hypothesis(), [0, 1, 2], list(wide)
    values[:3] = parameters
    for name, numbers in effects.items():
        hypothesis = hypothesis | name
        for number, value in numbers.items():
            row = plant.block.rows_of(name)[number]
            values[row] = value
            rows.append(row)
            sizes.append(0.05 * abs(value))
    names = tuple(str(row) for row in rows)
    spread = np.array(sizes)
    return Ensemble(
        plant,
        hypothesis,
        refined(plant),
        values,
        names,
        tuple(rows),
        spread,
        1e-6 * np.abs(values[rows]),
    )


PLANT = Plant.from_document(plant_document())
BOUNDS = Bounds.of(PLANT, 6.0)
NOISE, REST = np.array([0.01, 0.02]), np.zeros(2)
TIMES = np.asarray(np.arange(200) * PLANT.timestep_s)
COMMAND = np.sin(2.0 * TIMES)[:, None]


def apart(*ensembles):
    return SplittingGoal(ensembles, NOISE, REST).evaluate([(TIMES, COMMAND)]).least


def test_a_number_that_was_fitted_to_zero_can_still_give_way():
    small, none = ((TRUE[0], c, TRUE[2]) for c in (0.02, 0.0))
    assert apart(ensemble(PLANT, small), ensemble(PLANT, none)) < 1e-3


def test_what_a_sensor_rounds_parts_nothing():
    model = Corrected.restore(PLANT, {
        "parameters": dict(zip("kcb", TRUE, strict=True)), "scheme": {"alpha": 0.5, "parts": 1},
        "gain": [], "nearest": None,
        "effects": [{"effect": "sensor_quantization", "parameters": {"step": 0.02,
        "velocity_step": 0.0}}],
    }, {})  # fmt: skip
    numbers = {n: {"ci95": [0.98 * v, 1.02 * v]} for n, v in zip("kcb", TRUE, strict=True)}
    rounded = Ensemble.posterior(model, {"parameters": numbers, "effects": []})
    plain = Ensemble.posterior(
        replace(model, hypothesis=Hypothesis()), {"parameters": numbers, "effects": []}
    )
    assert apart(rounded, plain) < 1e-3


def test_a_model_that_runs_away_is_told_apart_from_nothing():
    softens = ensemble(PLANT, TRUE, cubic_stiffness={"coefficient": -400.0})
    assert apart(softens, ensemble(PLANT, TRUE)) == 0.0


def test_a_machine_that_sticks_under_all_but_the_largest_command_gets_one_under_which_it_stays():
    """Nothing of the room is used then, and the next size to try cannot be told from that."""
    stuck = ensemble(PLANT, TRUE, coulomb_friction={"level": 0.9 * TRUE[2]})
    narrow = Plant.from_document({**plant_document(), "envelope": {"q": [-1e-5, 1e-5]}})
    maker = Setting(InPlay((stuck,)), Bounds.of(narrow, 6.0), NOISE, REST, np.zeros(1)).maker(
        np.random.default_rng(0)
    )
    made = maker.made(maker.draw(np.random.default_rng(1)))
    assert made is not None
    assert made[2] < 1.0
    assert np.ptp(stuck.responses(stuck.centre[:, None], made[0], made[1], REST)[:, :, 0]) < 2e-5


def test_an_alternative_that_no_command_parts_does_not_spoil_the_others():
    answer = ensemble(PLANT, TRUE, constant_force={"level": 0.1})
    twin = ensemble(PLANT, TRUE, sensor_bias={"bias": 0.1 / TRUE[0]})
    other = ensemble(PLANT, TRUE, quadratic_drag={"coefficient": 0.4})
    rest = np.array([0.1 / TRUE[0], 0.0])
    excitation = splitting(
        Setting(InPlay((answer, twin, other)), BOUNDS, NOISE, rest, np.zeros(1)),
        np.random.default_rng(0),
        effort=0.1,
    )
    alike, parted = excitation.information.standard_errors
    assert alike < 4.0 < parted
    assert excitation.information.alternatives == (("sensor_bias",), ("quadratic_drag",))


def test_the_next_experiment_of_a_report_keeps_the_declared_envelope(undecided):
    plant, _, _, _, diagnosis = undecided
    said, also, head, *_ = diagnosis.experiment.csv(plant).split("\r\n")
    assert said.startswith(
        "# Before you play this: it begins at q = 0 rad, and keeps the declared envelope"
    )
    assert "does not end at rest" in also
    assert head.startswith("t,")
    answer = Ensemble.posterior(diagnosis.predictor, diagnosis.document)
    path = answer.responses(
        answer.centre[:, None], diagnosis.experiment.t_s, diagnosis.experiment.command, np.zeros(2)
    )[0]
    low, high = plant.envelope["q"]
    assert low < path[:, 0].min() < path[:, 0].max() < high


def test_without_an_envelope_it_keeps_what_was_recorded_and_says_what_that_costs(undecided):
    plant, _, _, episodes, _ = undecided
    diagnosis = diagnose(
        Plant.from_document({k: v for k, v in plant.document.items() if k != "envelope"}), episodes
    )
    assert diagnosis.experiment.command is None
    assert "inside its recorded range" in diagnosis.document["next_experiment"]["why"]
    assert "wider envelope" in diagnosis.document["next_experiment"]["why"]
