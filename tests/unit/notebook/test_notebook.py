"""A notebook's six lines: a case from tables, its diagnosis, its pictures, the model."""

import json
import subprocess
import sys

import numpy as np
import pytest

import trueup
from tests.support import recorded
from tests.support.robots import ARM
from trueup.diagnose.case import read_case
from trueup.errors import BadMapping, BadPlant, NotAnEpisode, NotIdentifiable
from trueup.notebook.diagnosis import Diagnosis

RUNS = [recorded.simulated(1200, seed) for seed in range(3)]
TABLES = [{"time_s": r.t_s, "pos": r.q, "vel": r.v, "torque": r.u} for r in RUNS]
MODEL = trueup.Oscillator(k=9.0, c=2.0, b=8.0)


def case_of(tables=TABLES, **named):
    columns = {"t": "time_s", "q": "pos", "v": "vel", "u": "torque", "plant": MODEL}
    return trueup.Case.from_table(tables, **columns | named)


@pytest.fixture(scope="module")
def answer():
    return trueup.diagnose(case_of())


def test_the_last_tables_are_held_out():
    assert [str(e.role) for e in case_of().episodes] == ["adaptation", "adaptation", "validation"]


def test_of_one_table_its_end_is_held_out():
    case = case_of(TABLES[0])
    assert [len(e.t_s) for e in case.episodes] == [840, 360]


def test_roles_may_be_given():
    case = case_of(roles=["validation", "adaptation", "adaptation"])
    assert str(case.episodes[0].role) == "validation"
    with pytest.raises(NotAnEpisode, match="2 roles are given for 3"):
        case_of(roles=["validation", "adaptation"])


def test_a_rate_takes_the_place_of_a_time():
    tables = [{k: v for k, v in t.items() if k != "time_s"} for t in TABLES]
    case = trueup.Case.from_table(tables, plant=MODEL, rate_hz=100.0)
    assert case.episodes[0].period_s == pytest.approx(0.01)


def test_what_was_guessed_stands_beside_the_case():
    assert "the unit of pos (rad)" in repr(case_of())
    assert case_of(units={"q": "rad", "v": "rad/s"}).guesses == ()


def test_a_column_that_is_not_there_is_named_with_those_that_are():
    with pytest.raises(BadMapping, match="'angle'") as refused:
        case_of(q="angle")
    assert "pos" in refused.value.hint


def test_limits_and_envelope_may_be_given():
    model = trueup.Pendulum(
        k=9.8,
        c=0.1,
        b=1.0,
        name="arm",
        limits={"u": (-2.0, 3.0)},
        envelope={"q": (-1.0, 1.0)},
        timestep_s=0.005,
        horizon_s=0.5,
    )
    plant = case_of(plant=model).plant
    assert plant.layout.commands[0].limits == (-2.0, 3.0)
    assert plant.envelope == {"q": (-1.0, 1.0)}
    assert (plant.name, plant.timestep_s, plant.horizon_s) == ("arm", 0.005, 0.5)
    with pytest.raises(BadPlant, match="no command 'w'"):
        case_of(plant=trueup.Inertia(c=0.1, b=1.0, limits={"w": (-1.0, 1.0)}))


def test_without_a_model_the_simplest_one_is_identified():
    case = trueup.Case.from_table(TABLES)
    assert case.plant.family in ("pendulum", "oscillator")


def test_the_answer_names_the_effect_with_its_interval(answer):
    assert isinstance(answer, Diagnosis)
    assert answer.verdict == "effect"
    (effect,) = answer.effects
    level = effect.estimates["level"]
    assert effect.effect == "coulomb_friction"
    assert level.ci95[0] < level.value < level.ci95[1]
    assert level.value == pytest.approx(0.6, rel=0.05)
    assert answer.gap.after < 0.1 * answer.gap.before
    assert answer.alternatives == ()
    assert repr(answer) == answer.sentence
    assert "coulomb_friction(level = 0.6" in repr(effect) or "0.59" in repr(effect)


def test_the_model_predicts_and_is_saved_as_the_command_saves_it(answer, tmp_path):
    path = answer.model.rollout({"q": 0.2}, np.zeros(50))
    assert path.shape == (50, 2)
    loaded = trueup.load(answer.save(tmp_path) / "model")
    assert loaded.digest == answer.model.digest
    np.testing.assert_array_equal(loaded.rollout({"q": 0.2}, np.zeros(50)), path)
    assert json.loads((tmp_path / "report.json").read_text())["verdict"] == "effect"


def test_a_case_is_saved_as_the_command_takes_it(answer, tmp_path):
    plant, episodes = read_case(case_of().save(tmp_path / "case"))
    assert plant.digest == answer.case.plant.digest
    ours = {e.samples_digest for e in answer.case.episodes}
    assert {e.samples_digest for e in episodes} == ours
    again = trueup.Case.read(tmp_path / "case")
    assert len(again.episodes) == 3


def test_a_notebook_shows_the_sentence_the_map_and_the_ranking(answer):
    html = answer._repr_html_()
    assert answer.sentence.split(";")[0] in html
    assert html.count("<svg") == 4
    assert "the answer" in html
    assert "<script" not in html


def test_pictures_are_figures(answer):
    assert len(answer.plot.where().axes) == 6  # two channels, two models, a scale each
    assert answer.plot.ranking().axes[0].get_xscale() == "log"
    assert len(answer.plot.predictions().axes) == 2


def test_progress_is_told(capsys):
    stages = []
    trueup.diagnose(case_of(), progress=lambda stage, part: stages.append((stage, part)))
    assert stages[-1] == ("done", 1.0)


def test_the_package_of_the_same_name_is_the_same_function():
    said = subprocess.run(
        [
            sys.executable,
            "-c",
            "import trueup, trueup.diagnose.case\n"
            "print(callable(trueup.diagnose), trueup.Case is not None, callable(trueup.diagnose))\n"
            "from trueup.diagnose.diagnosis import diagnose",
        ],
        capture_output=True,
        text=True,
        check=True,
    )
    assert said.stdout.split()[1:] == ["True", "True"]


def test_files_of_any_format_make_a_case(tmp_path):
    for i, run in enumerate(RUNS):
        recorded.as_csv(run, tmp_path / f"{i}.csv")
    case = trueup.Case.from_recordings(tmp_path, plant=MODEL)
    assert [e.source["file"] for e in case.episodes] == ["0.csv", "1.csv", "2.csv"]
    assert case.guesses == ()


def test_a_robot_is_given_by_its_file(tmp_path):
    pytest.importorskip("mujoco")
    (tmp_path / "arm.xml").write_text(ARM)
    columns = {"t_s": RUNS[0].t_s} | {
        f"{joint}_{what}": values
        for joint in ("shoulder", "elbow")
        for what, values in (
            ("pos_rad", RUNS[0].q),
            ("vel_rad_s", RUNS[0].v),
            ("cmd_nm", RUNS[0].u),
        )
    }
    case = trueup.Case.from_table(columns, plant=trueup.Robot(tmp_path / "arm.xml"))
    assert case.plant.joints == ("shoulder", "elbow")
    assert [c.name for c in case.plant.layout.commands] == ["u_shoulder", "u_elbow"]


def test_two_models_are_compared_on_what_neither_was_fitted_to(answer):
    case = answer.case
    comparison = trueup.compare(answer, case.plant, case)
    assert comparison.ci95[1] < 1.0
    assert "the first predicts better" in repr(comparison)
    assert comparison.rms["q"][0] < 0.1 * comparison.rms["q"][1]
    assert "<table>" in comparison._repr_html_()
    alike = trueup.compare(answer, answer.model, case)
    assert alike.ratio == 1.0
    assert "do not tell them apart" in alike.sentence
    with pytest.raises(NotAnEpisode, match="holds no episode out"):
        trueup.compare(answer, case.plant, case_of(roles=["adaptation"] * 3))


@pytest.mark.slow
def test_a_blind_trial_says_how_often_such_machines_are_answered_exactly():
    stages = []
    trial = trueup.blind_trial(case_of(), trials=2, progress=lambda stage, _: stages.append(stage))
    assert trial.report["trials"] == 2
    assert trial.exact == (2 - len(trial.misses)) / 2
    assert "of 2 machines like plant" in repr(trial)
    assert "diagnosing" in stages
    assert "machines like" in trial._repr_html_()


@pytest.mark.slow
def test_the_next_experiment_is_designed_within_the_limits(answer, tmp_path):
    from trueup.diagnose.excitation_design import Allowed

    experiment = trueup.excite(answer.case, answer, allowed=Allowed(duration_s=1.0))
    low, high = answer.case.plant.limits
    assert experiment.commands.shape == (len(experiment.t_s), 1)
    assert (experiment.commands >= low).all()
    assert (experiment.commands <= high).all()
    assert "check before you play them" in repr(experiment)
    assert experiment._repr_html_().count("<li>") == len(experiment.check_first)
    assert {p.name for p in experiment.save(tmp_path).iterdir()} == {
        "excitation.csv",
        "excitation.json",
    }
    with pytest.raises(NotIdentifiable, match="left no alternatives"):
        trueup.excite(answer.case, answer, split=True)


def test_what_was_guessed_is_told_with_the_answer(answer):
    assert any("confirmed by nobody: the unit of pos (rad)" in w for w in answer.warnings)
    sure = trueup.diagnose(case_of(units={"q": "rad", "v": "rad/s"}))
    assert not any("confirmed by nobody" in w for w in sure.warnings)
