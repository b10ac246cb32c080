"""Designed excitations: bounded, safe under every model still in play, ending at rest, and worth
more than a random one."""

import json
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest

from tests.support.made import TRUE, plant_document
from trueup.collect.bounds import Bounds, Recorded
from trueup.collect.checklist import checks
from trueup.collect.ensemble import Ensemble, InPlay
from trueup.collect.excitation import Setting, at_rest, identification, resting
from trueup.collect.wave import AT_REST
from trueup.diagnose.diagnosis import diagnose
from trueup.diagnose.excitation_design import SPREAD
from trueup.episode.mcap import read_episode
from trueup.episode.role import Role
from trueup.episode.writer import write_episode
from trueup.errors import BadPlant, NotAnEpisode, NotIdentifiable
from trueup.model.plant import Plant
from trueup_cli.excite import excite

pytestmark = pytest.mark.slow  # whole diagnoses, designs or installations

DOCUMENT = {
    **plant_document(),
    "nominal": {
        "family": "oscillator",
        "parameters": dict(zip("kcb", TRUE, strict=True)),
        "timestep_s": 0.05,
    },
}
PLANT = Plant.from_document(DOCUMENT)
NOISE = np.array([0.01, 0.02])


def designed(plant=PLANT, spread=0.02, seed=0, duration_s=8.0, **bounds):
    ensemble = Ensemble.prior(plant, spread)
    setting = Setting(
        InPlay((ensemble,)), Bounds.of(plant, duration_s, **bounds), NOISE, np.zeros(2), np.zeros(1)
    )
    return identification(setting, np.random.default_rng(seed), effort=0.2)


@pytest.fixture(scope="module")
def design():
    return designed(spread=SPREAD)


def test_it_stays_inside_the_envelope_with_its_margin_under_a_thousand_models(design):
    assert design.breaches == 0
    assert design.paths.shape[0] == 1000
    assert np.abs(design.paths[:, :, 0]).max() <= 0.9 * 0.9 + 1e-12
    assert 0.6 < design.used <= 0.9  # and it uses what it is given


def test_it_is_bounded_in_command_and_rate_and_returns_to_rest(design):
    step = np.abs(np.diff(design.command[:, 0]))
    assert np.abs(design.command).max() <= 1.0
    assert step.max() <= design.bounds.rate[0] * 0.05 + 1e-12
    assert design.command[0] == design.command[-1] == 0.0
    speed = np.abs(design.paths[:, :, 1])
    assert design.rests
    assert speed[:, -1].max() <= AT_REST * speed.max()


@pytest.mark.parametrize(
    ("spread", "duration_s", "seed"),
    [(0.02, 8.0, 0), (SPREAD, 6.0, 0), (SPREAD, 6.0, 1), (SPREAD, 12.0, 2), (SPREAD, 3.0, 3)],
)
def test_it_tells_every_number_better_than_random_ones_within_the_same_bounds(
    spread, duration_s, seed
):
    made = designed(spread=spread, duration_s=duration_s, seed=seed)
    assert made.information.rank == 3
    assert made.information.condition < 10.0
    random = made.random
    assert set(made.information.half_widths) == {"k", "c", "b"}
    for name, width in made.information.half_widths.items():
        assert width < random.information.half_widths[name]
    assert made.breaches == 0
    assert 5 <= random.count <= 20
    assert random.breaches <= random.count // 2  # they are made for fewer models than they meet


def test_unbounded_random_ones_of_its_energy_are_said_to_leave_the_envelope():
    random = designed(spread=SPREAD, duration_s=6.0).random
    assert random.unbounded_breaches > 5
    said = random.document()["of_same_energy_unbounded"]
    assert said == {"excitations": 20, "breaches": random.unbounded_breaches}


def test_the_same_seed_gives_the_same_excitation(design):
    assert np.array_equal(designed(spread=SPREAD).command, design.command)


def test_a_slower_drive_and_a_narrower_envelope_are_kept():
    narrow = Plant.from_document({**DOCUMENT, "envelope": {"q": [-0.2, 0.2]}})
    made = designed(narrow, rate=2.0, duration_s=6.0)
    assert np.abs(made.paths[:, :, 0]).max() <= 0.18 + 1e-12
    assert np.abs(np.diff(made.command[:, 0])).max() <= 0.1 + 1e-12


def test_two_sensors_of_one_motion_are_kept_within_both_their_ranges():
    channels = [
        {"name": name, "unit": "rad", "field": "position"} for name in ("q_motor", "q_link")
    ]
    envelope = {"q_motor": [-0.2, 0.9], "q_link": [-0.9, 0.3]}
    plant = Plant.from_document({**DOCUMENT, "observations": channels, "envelope": envelope})
    assert Bounds.of(plant, 6.0, margin=0.0).envelope[0] == pytest.approx([-0.2, 0.3])
    apart = Plant.from_document(
        {**plant.document, "envelope": {"q_motor": [-0.9, -0.5], "q_link": [0.5, 0.9]}}
    )
    with pytest.raises(NotIdentifiable, match="nothing in common"):
        Bounds.of(apart, 6.0)


def test_an_envelope_of_no_channel_is_told_and_not_passed_over(tmp_path):
    (tmp_path / "plant.json").write_text(json.dumps({**DOCUMENT, "envelope": {"Q": [-0.1, 0.1]}}))
    with pytest.raises(BadPlant, match="'Q', which is no observation"):
        excite(str(tmp_path), out=tmp_path / "out")


@pytest.mark.parametrize("duration_s", [0.0, float("inf"), float("nan")])
def test_a_duration_without_end_is_refused(duration_s):
    with pytest.raises(BadPlant, match="duration"):
        Bounds.of(PLANT, duration_s)


FREE = Plant.from_document({k: v for k, v in DOCUMENT.items() if k != "envelope"})


def recording(low=-0.2, high=0.3, fastest=0.5, role=Role.ADAPTATION):
    """A recording of which the ranges are known: a slow sine between two positions, and commands
    that change by 0.1 in a sample."""
    t = np.asarray(np.arange(200) * 0.05)
    middle, half = (low + high) / 2.0, (high - low) / 2.0
    rate = fastest / half
    states = np.column_stack([middle + half * np.sin(rate * t), fastest * np.cos(rate * t)])
    commands = np.where(np.arange(200) % 2, 0.05, -0.05)[:, None]
    stream = BytesIO()
    stamps = np.rint(t * 1e9).astype(np.int64)
    write_episode(
        stream,
        stamps_ns=stamps,
        observations=states,
        commands=commands,
        layout=FREE.layout,
        role=role,
        conditions={},
    )
    return stream.getvalue()


def test_where_nothing_bounds_the_travel_nothing_is_designed():
    with pytest.raises(NotIdentifiable, match="how far joint may travel") as refused:
        Bounds.of(FREE, 6.0)
    assert "envelope" in refused.value.hint


def test_without_an_envelope_the_recorded_range_speed_and_rate_bind():
    been = Recorded.of(FREE, [read_episode(recording(), FREE.layout)])
    assert been.ranges == pytest.approx(np.array([[-0.2, 0.3], [-0.5, 0.5]]), abs=0.01)
    assert been.rate == pytest.approx([2.0])
    bounds = Bounds.of(FREE, 6.0, recorded=been)
    assert bounds.sources == ("recorded", "recorded")
    made = designed(FREE, duration_s=6.0, recorded=been)
    low, high = 0.05 - 0.9 * 0.25, 0.05 + 0.9 * 0.25
    assert low - 0.01 <= made.paths[:, :, 0].min() < made.paths[:, :, 0].max() <= high + 0.01
    assert np.abs(made.paths[:, :, 1]).max() <= 0.9 * 0.5 + 0.01
    assert np.abs(np.diff(made.command[:, 0])).max() <= 2.0 * 0.05 + 1e-12
    assert (made.breaches, made.rests) == (0, True)


def test_what_is_declared_or_given_comes_before_what_was_recorded():
    been = Recorded.of(FREE, [read_episode(recording(), FREE.layout)])
    bounds = Bounds.of(PLANT, 6.0, rate=7.0, speed=2.0, margin=0.0, recorded=been)
    assert bounds.sources == ("declared", "given")
    assert bounds.envelope == pytest.approx(np.array([[-0.9, 0.9], [-2.0, 2.0]]))
    assert (bounds.rate.tolist(), bounds.rate_sources) == ([7.0], ("given",))


def test_it_begins_where_there_is_most_room_and_not_outside():
    been = Recorded.of(FREE, [read_episode(recording(), FREE.layout)])
    bounds, ensemble = Bounds.of(FREE, 6.0, recorded=been), Ensemble.prior(FREE, 0.1)
    edge = FREE.parameters[0] * 0.25 / FREE.parameters[2]
    hold, rest = resting(
        ensemble, bounds, [(np.array([edge]), np.zeros(2)), (np.zeros(1), np.zeros(2))]
    )
    assert (hold.tolist(), rest == pytest.approx([0.0, 0.0], abs=1e-6)) == ([0.0], True)
    with pytest.raises(NotIdentifiable, match="outside of the envelope"):
        resting(ensemble, bounds, [(np.array([2.0 * edge]), np.zeros(2))])


def test_what_to_check_says_where_each_bound_comes_from(design):
    sentences = checks(PLANT, design, diagnosed=False)
    assert sentences[0].startswith("Bring the machine to rest at q = 0 m")
    assert "from -0.9 to 0.9 m (declared in plant.json); 10 % of it is kept free" in sentences[1]
    assert sentences[2] == "The speed of joint stays between -3 and 3 m/s (declared in plant.json)."
    assert "by the band alone" in sentences[3]
    assert sentences[4].startswith("It ends at rest under every one of 1000 models")
    assert "no diagnosis has confirmed" in sentences[5]
    moving = checks(PLANT, replace(design, rests=False), diagnosed=True)
    assert moving[4].startswith("It does NOT end at rest")
    assert "that the diagnosis left" in moving[5]


def test_a_machine_that_never_rests_is_refused_and_told_what_to_do():
    document = {
        **plant_document(),
        "nominal": {
            "family": "oscillator",
            "parameters": {"k": 1.0, "c": -0.1, "b": 1.0},
            "timestep_s": 0.05,
        },
    }
    plant = Plant.from_document(document)
    with pytest.raises(NotIdentifiable, match="does not come to rest") as refused:
        at_rest(Ensemble.prior(plant, 0.1), np.array([0.1, 0.0]), np.zeros(1))
    assert "controller" in refused.value.hint


def test_rest_is_where_the_machine_hangs():
    pendulum = Plant.from_document(
        {
            **plant_document(),
            "nominal": {
                "family": "pendulum",
                "parameters": {"k": 4.0, "c": 1.0, "b": 1.0},
                "timestep_s": 0.05,
            },
        }
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
    level = ensemble.drawn(200, np.random.default_rng(1))[
        ensemble.rows[ensemble.names.index("coulomb_friction level")]
    ]
    assert (level > 0.0).all()


def test_the_command_writes_what_a_robot_plays_and_no_episode(tmp_path, capsys):
    (tmp_path / "plant.json").write_text(json.dumps(plant_document()))
    excite(str(tmp_path), out=tmp_path / "out", spread=0.1, duration_s=3.0)
    document = json.loads((tmp_path / "out" / "excitation.json").read_text())
    rows = (tmp_path / "out" / "excitation.csv").read_text().splitlines()
    said = [row.removeprefix("# ") for row in rows if row.startswith("#")]
    assert said == document["check_first"]
    assert rows[len(said)] == "t,u"
    assert len(rows) == len(said) + 1 + document["samples"]
    assert np.loadtxt(
        tmp_path / "out" / "excitation.csv", delimiter=",", skiprows=len(said) + 1
    ).shape == (document["samples"], 2)
    assert next(iter(document)) == "check_first"
    assert (document["breaches"], document["information"]["rank"]) == (0, 3)
    assert (tmp_path / "out" / "excitation.svg").read_text().startswith("<svg")
    with pytest.raises(NotAnEpisode):
        read_episode((tmp_path / "out" / "excitation.mcap").read_bytes(), PLANT.layout)
    shown = capsys.readouterr().out
    assert shown.startswith("Check before you play it")
    assert "designed" in shown


def test_the_command_keeps_what_was_recorded_of_an_axis_that_nothing_holds(tmp_path):
    """An axis with neither spring nor envelope, 10 V and a quarter of a metre: what it may do is
    what it has done."""
    axis = {
        **{k: v for k, v in plant_document().items() if k != "envelope"},
        "nominal": {"family": "inertia", "parameters": {"c": 2.1, "b": 0.37}, "timestep_s": 0.05},
        "commands": [{"name": "u", "unit": "V", "limits": [-10.0, 10.0]}],
    }
    (tmp_path / "plant.json").write_text(json.dumps(axis))
    with pytest.raises(NotIdentifiable, match="may travel"):
        excite(str(tmp_path), out=tmp_path / "out", duration_s=4.0)
    (tmp_path / "0.mcap").write_bytes(recording(0.0, 0.25, 0.13))
    excite(str(tmp_path), out=tmp_path / "out", duration_s=4.0)
    document = json.loads((tmp_path / "out" / "excitation.json").read_text())
    t, u = np.loadtxt(
        tmp_path / "out" / "excitation.csv",
        delimiter=",",
        skiprows=len(document["check_first"]) + 1,
    ).T
    plant = Plant.from_document(axis)
    ensemble = Ensemble.prior(plant, 0.3)
    paths = ensemble.responses(
        ensemble.drawn(200, np.random.default_rng(9)), t, u[:, None], np.array([0.125, 0.0])
    )
    assert 0.0 < paths[:, :, 0].min() < paths[:, :, 0].max() < 0.25
    assert np.abs(paths[:, :, 1]).max() < 0.13
    assert np.abs(paths[:, -1, 1]).max() < 0.01 * np.abs(paths[:, :, 1]).max()
    assert "as recorded, for no envelope is declared" in document["check_first"][1]
    assert "recorded range" in (tmp_path / "out" / "excitation.svg").read_text()
