"""A simulator of one's own: its rollout is the compiled one's, effect by effect, and what breaks a
rule is refused."""

import numpy as np
import pytest

from tests.support import windowed
from tests.support.service import ROOT
from trueup.episode.episode import Episode
from trueup.episode.role import Role
from trueup.errors import BadPlant, BadSimulator
from trueup.fit.base_parameters import directions
from trueup.fit.identify import identify
from trueup.model.effect import Port, effects
from trueup.model.hypothesis import Hypothesis, Scales, switches
from trueup.model.plant import Plant
from trueup.model.roll import roll_parts
from trueup.model.simulator.simulator import Simulator, load_simulator, offer

EXAMPLE = ROOT / "examples" / "own-simulator" / "pendulum.py"
PARAMETERS = {"k": 9.8, "c": 0.2, "b": 1.0}
CHANNELS = {
    "commands": [{"name": "u", "limits": [-6, 6]}],
    "observations": [{"name": "q", "unit": "rad"}, {"name": "v", "unit": "rad/s"}],
    "evaluation": {"horizon_s": 1.0},
}
SAMPLES, PERIOD_S, SIZES = 301, 0.01, Scales(1.0, 2.0, 5.0, 6.0)
# the compiled rollout works these out at one moment of a step, the other from means over a step
ABOUT = {
    "hard_stop": 2e-2,
    "elastic_transmission": 1e-3,
    "load_dependent_friction": 2e-3,
    "cogging": 5e-4,
    "cubic_stiffness": 5e-4,
}


def leapfrog(state, command, parameters, force, h_s):
    k, c, b = (parameters[name] for name in "kcb")
    q = state[:, 0] + 0.5 * h_s * state[:, 1]
    driven = b * command[:, 0] + force[:, 0] - k * np.sin(q)
    v = state[:, 1] + 0.5 * h_s * (driven - c * state[:, 1])
    after = state[:, 1] + h_s * (driven - c * v)
    return np.column_stack([q + 0.5 * h_s * after, after])


def without_force(state, command, parameters):
    return leapfrog(state, command, parameters, np.zeros_like(command), PERIOD_S)


def with_a_lag(state, command, parameters):
    """A drive that follows its command late, which nobody observes."""
    drive = state[:, 2] + 0.2 * (command[:, 0] - state[:, 2])
    moved = without_force(state[:, :2], drive[:, None], parameters)
    return np.column_stack([moved, drive])


def plant_of(step, parameters=PARAMETERS, **more):
    nominal = {"simulator": "own", "sha256": offer(step), "parameters": parameters, **more}
    return Plant.from_document(
        {"name": "own", "nominal": {"timestep_s": PERIOD_S, **nominal}, **CHANNELS}
    )


COMPILED = Plant.from_document(
    {
        "name": "compiled",
        "nominal": {"family": "pendulum", "parameters": PARAMETERS, "timestep_s": PERIOD_S},
        **CHANNELS,
    }
)


def series_of(begins=0, every=100, samples=SAMPLES, period_s=PERIOD_S):
    t = np.arange(samples) * period_s
    u = (4.0 * np.sin(2.0 * t) + 2.0 * np.sign(np.sin(5.0 * t)))[:, None]
    noise = 0.01 * np.random.default_rng(1).normal(size=(samples, 2))
    observed = np.column_stack([np.sin(t), np.cos(t)]) + noise
    return windowed.series_of(u, observed, period_s, [6.0], begins, every)


def rolled(plant, hypothesis, s, gain=None, rolled_by=windowed.rolled):
    """A hypothesis with its numbers, its starts and its past moved a little in some lanes."""
    moved = [plant.dynamics.parameter_names.index(n) for n in "kcb"]
    return rolled_by(plant.form, plant.parameters, hypothesis, s, SIZES, gain, moved)


def filter_gain():
    """Gains of a filter: nothing is corrected at first."""
    gain = np.zeros((3, 1, 4, 2))
    gain[1:, 0, [0, 1, 2, 3], [0, 1, 1, 1]] = 0.3, 0.3, 2.0, 0.2
    return gain


def recorded(seed):
    """An episode of the compiled plant, from rest."""
    t = PERIOD_S * np.arange(400.0)
    u = 3.0 * np.sin((2.0 + seed) * t)[:, None] + np.cos(5.0 * t)[:, None]
    states = np.zeros((len(t), 2))
    for i in range(len(t) - 1):
        states[i + 1] = COMPILED.update(states[i : i + 1], u[i : i + 1])[0]
    return Episode(t, u, states, COMPILED.layout, Role.ADAPTATION, {}, 0, f"run {seed}")


@pytest.fixture(scope="module")
def own():
    return plant_of(leapfrog)


@pytest.mark.parametrize("name", ["", *effects()])
@pytest.mark.parametrize("begins", [0, 7])
def test_every_effect_acts_as_in_the_compiled_rollout(own, name, begins):
    hypothesis, s = Hypothesis((name,) if name else ()), series_of(begins)
    counted = s.window_of >= 0
    at_force = name and effects()[name].port in (Port.FORCE, Port.FRICTION)
    about = ABOUT.get(name, 1e-4 if at_force else 1e-12)
    given, expected = (rolled(plant, hypothesis, s)[counted] for plant in (own, COMPILED))
    np.testing.assert_allclose(given, expected, atol=about)


@pytest.mark.parametrize("name", ["", *effects()])
def test_a_filter_runs_ahead_of_windows_as_in_the_compiled_rollout(own, name):
    hypothesis, s = Hypothesis((name,) if name else ()), series_of()
    at_force = name and effects()[name].port in (Port.FORCE, Port.FRICTION)
    about = ABOUT.get(name, 5e-4 if at_force else 1e-12)
    given, expected = (rolled(plant, hypothesis, s, filter_gain()) for plant in (own, COMPILED))
    np.testing.assert_allclose(given[:, :, :2], expected[:, :, :2], atol=about)


@pytest.mark.parametrize("name", ["", *effects()])
@pytest.mark.parametrize("gain", [None, filter_gain()], ids=["windows", "filter"])
def test_episodes_side_by_side_are_rolled_out_as_each_alone(own, name, gain):
    hypothesis = Hypothesis((name,) if name else ())
    each = [
        rolled(own, hypothesis, s, gain, windowed.asked)
        for s in (series_of(), series_of(samples=180, period_s=2 * PERIOD_S), series_of(every=150))
    ]
    on = switches(hypothesis, 1)
    of_all = roll_parts(own.form, on, windowed.together(each), lambda _, out: out, alone=True)
    for given, one in zip(of_all, each, strict=True):
        (alone,) = roll_parts(own.form, on, one, lambda _, out: out)
        np.testing.assert_allclose(given, alone, rtol=0.0, atol=1e-12)


def test_effects_together_act_as_in_the_compiled_rollout(own):
    both = Hypothesis() | "backlash" | "coulomb_friction" | "velocity_lag"
    given, expected = (rolled(plant, both, series_of()) for plant in (own, COMPILED))
    np.testing.assert_allclose(given, expected, atol=1e-4)


def test_the_nominal_model_is_the_simulator_step_by_step(own):
    windows = np.random.default_rng(3).normal(size=(4, 2))
    applied = np.random.default_rng(4).normal(size=(4, 20, 1))
    both = PARAMETERS, {"k": 5.0, "c": 0.1, "b": 2.0}
    h_s, steps = np.full((4, 20), PERIOD_S), np.full((4, 20), 2)
    steps[1, 10:] = 0
    given, expected = (
        plant.dynamics.rollout(
            np.array([[sizes[n] for n in plant.dynamics.parameter_names] for sizes in both]),
            windows, applied, h_s, steps,
        )
        for plant in (own, COMPILED)
    )  # fmt: skip
    assert given.shape == expected.shape
    # leapfrog and semi-implicit Euler differ by the order of a step
    np.testing.assert_allclose(given[:, :, 1], expected[:, :, 1], atol=0.02)
    now = windows[:1]
    for i in range(19):
        np.testing.assert_array_equal(given[0, 0, i], now[0])
        for _ in range(2):
            lanes = {name: np.array([x]) for name, x in PARAMETERS.items()}
            now = leapfrog(now, applied[:1, i], lanes, np.zeros((1, 1)), PERIOD_S)


def test_hidden_states_run_through(own):
    plant = plant_of(with_a_lag, begins=[0.0])
    s = series_of(every=SAMPLES)
    given = rolled(plant, Hypothesis(), s)[:, :, 0]
    in_parts = series_of(every=60)
    split = rolled(plant, Hypothesis(), in_parts)[:, :, 0]
    state = np.array([[*given[0], 0.0]])
    lanes = {name: np.array([x]) for name, x in PARAMETERS.items()}
    for i in range(SAMPLES - 1):
        np.testing.assert_allclose(given[i], state[0, :2], atol=1e-12)
        state = with_a_lag(state, s.issued[i : i + 1], lanes)
        if (
            in_parts.resets[i + 1] >= 0 and i + 2 < SAMPLES
        ):  # the drive keeps its past where a window starts
            begun_at = np.array([[*split[i + 1], *state[0, 2:]]])
            after = with_a_lag(begun_at, s.issued[i + 1 : i + 2], lanes)
            np.testing.assert_allclose(split[i + 2], after[0, :2], atol=1e-12)


def test_a_part_of_a_step_is_taken_in_proportion():
    simulator = plant_of(without_force).form.simulator
    state, u = np.array([[0.3, 0.0]]), np.array([[1.0]])
    lanes = {name: np.array([x]) for name, x in PARAMETERS.items()}
    whole = simulator.moved(state, u, lanes) - state
    half = simulator.moved(state, u, lanes, np.array([PERIOD_S / 2.0])) - state
    np.testing.assert_allclose(half, whole / 2.0)


def test_of_numbers_that_show_only_together_the_last_stays_as_declared():
    load_simulator(EXAMPLE)
    given = {"inertia": 0.1, "kt": 0.5, "damping": 0.05, "mgl": 1.0}
    nominal = {"simulator": EXAMPLE.name, "sha256": load_simulator(EXAMPLE), "parameters": given}
    plant = Plant.from_document(
        {"name": "own", "nominal": {**nominal, "timestep_s": PERIOD_S}, **CHANNELS}
    )
    episodes = [recorded(seed) for seed in range(2)]
    assert directions(plant, episodes).names == ("damping", "inertia", "kt")
    identified, report = identify(plant, episodes)
    found = dict(zip(plant.dynamics.parameter_names, identified.parameters, strict=True))
    assert found["mgl"] == 1.0
    assert found["mgl"] / found["inertia"] == pytest.approx(9.8, rel=0.02)
    assert set(report.parameters) == {"damping", "inertia", "kt"}


def test_an_onnx_model_is_a_simulator(tmp_path):
    onnx = pytest.importorskip("onnx")
    make, kind = onnx.helper.make_tensor_value_info, onnx.TensorProto.DOUBLE
    node = onnx.helper.make_node
    graph = onnx.helper.make_graph(
        [
            node("Split", ["state"], ["q", "v"], axis=1, num_outputs=2),
            node("Sin", ["q"], ["sine"]),
            node("Mul", ["k", "sine"], ["back"]),
            node("Sub", ["command", "back"], ["a"]),
            node("Mul", ["a", "h"], ["gained"]),
            node("Add", ["v", "gained"], ["after"]),
            node("Mul", ["after", "h"], ["travelled"]),
            node("Add", ["q", "travelled"], ["moved"]),
            node("Concat", ["moved", "after"], ["next_state"], axis=1),
        ],
        "own",
        [make(name, kind, ["n", size]) for name, size in (("state", 2), ("command", 1), ("k", 1))],
        [make("next_state", kind, ["n", 2])],
        [onnx.numpy_helper.from_array(np.array(PERIOD_S), "h")],
    )
    file = tmp_path / "own.onnx"
    file.write_bytes(
        onnx.helper.make_model(
            graph, ir_version=9, opset_imports=[onnx.helper.make_opsetid("", 18)]
        ).SerializeToString()
    )
    nominal = {"simulator": file.name, "sha256": load_simulator(file), "parameters": {"k": 9.8}}
    plant = Plant.from_document(
        {"name": "own", "nominal": {**nominal, "timestep_s": PERIOD_S}, **CHANNELS}
    )
    states, u = np.random.default_rng(5).normal(size=(6, 2)), np.ones((6, 1))
    after = plant.update(states, u)
    v = states[:, 1] + PERIOD_S * (1.0 - 9.8 * np.sin(states[:, 0]))
    np.testing.assert_allclose(after, np.column_stack([states[:, 0] + PERIOD_S * v, v]))
    assert not plant.dynamics.takes_force


def keeps_something():
    seen = []

    def step(state, command, parameters):
        seen.append(1)
        return state + len(seen)

    return step


@pytest.mark.parametrize(
    ("step", "why"),
    [
        (lambda state, command: state, "takes state, command and parameters"),
        (lambda state, command, parameters, torque: state, "takes state, command and parameters"),
        (lambda state, command, parameters: state[:1], "returned"),
        (lambda state, command, parameters: state / parameters["mass"], "failed: KeyError"),
        (lambda state, command, parameters: state * np.nan, "no finite state"),
        (lambda state, command, parameters: state + state.mean(), "mixes its lanes"),
        (keeps_something(), "keeps something"),
        (
            lambda state, command, parameters, force: without_force(state, command, parameters),
            "does not move",
        ),
    ],
)
def test_a_step_that_breaks_a_rule_is_refused_with_it(step, why):
    with pytest.raises(BadSimulator, match=why):
        plant_of(step)


def test_one_that_is_not_at_hand_is_refused():
    document = {"name": "own", **CHANNELS}
    nominal = {"simulator": "gone", "sha256": "0" * 64, "parameters": {"k": 1.0}, "timestep_s": 0.1}
    with pytest.raises(BadSimulator, match="not here"):
        Plant.from_document({**document, "nominal": nominal})
    with pytest.raises(BadPlant):
        Plant.from_document({**document, "nominal": {**nominal, "step": 1}})


def test_what_a_function_closes_over_belongs_to_its_digest():
    def made(gain):
        def step(state, command, parameters):
            return state + gain * command

        return step

    assert offer(made(1.0)) == offer(made(1.0))
    assert offer(made(1.0)) != offer(made(2.0))


def test_a_simulator_says_its_parameters():
    with pytest.raises(BadSimulator, match="no parameter"):
        Simulator("own", without_force, {}, 0.1).checked()
