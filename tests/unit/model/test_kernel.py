"""The compiled rollout: what its ports call, in which order, and that compiling changes no bit."""

import numpy as np
import pytest

from tests.support.made import plant_document
from tests.support.robots import arm_plant
from trueup.model import kernel as kernels
from trueup.model import kernel_sample
from trueup.model.block import BLOCK, term
from trueup.model.dynamics import CompiledFamily
from trueup.model.effect import effects
from trueup.model.family import families
from trueup.model.kernel import kernel
from trueup.model.plant import Plant
from trueup.model.ports import LAG_S, LATE_S, PAST, Q_AT, SIGNALS_AT_JOINT, Q, U, V
from trueup.model.roll import roll
from trueup.model.series import Scheme, unobserved

SAMPLES = 12
SYMMETRIC = Scheme(0.5, 2)


def plant(name, tmp_path):
    return arm_plant(tmp_path) if name == "arm" else Plant.from_document(plant_document())


def rolled(of, on, values=0.02):
    """A rollout under a sweep of commands, with some effects on at every joint, all their numbers
    `values`."""
    joints, form = len(of.joints), of.dynamics.form
    t = np.arange(SAMPLES) * of.timestep_s
    command = np.sin(np.outer(np.arange(SAMPLES), np.arange(1, joints + 1)))
    s = unobserved(SYMMETRIC, t, command, of.command_scales, of.timestep_s)
    p = np.repeat(form.block.nulls[:, None], BLOCK, axis=1)
    p[: len(of.parameters)] = np.array(of.parameters)[:, None] * (1 + 0.01 * np.arange(BLOCK))
    acts = np.zeros((len(effects()), joints), np.uint8)
    for name in on:
        acts[list(effects()).index(name)] = 1
        for joint in range(joints):
            p[list(form.block.rows(term(name, joint)))] = values
    init = np.repeat((0.1 * np.arange(1, 2 * joints + 1))[None, :, None], BLOCK, axis=2)
    return roll(s, form, p, acts, init)


def test_one_kernel_serves_commands_however_they_lie_in_memory():
    """Arrays in the order of Fortran would be compiled for anew, which takes a quarter minute."""
    command = np.asfortranarray(np.ones((SAMPLES, 2)))
    s = unobserved(SYMMETRIC, np.arange(SAMPLES) * 0.1, command, np.ones(2), 0.1)
    assert all(x.flags.c_contiguous for x in (s.issued, s.rise, s.integral))


@pytest.mark.parametrize("name", ["one joint", "arm"])
@pytest.mark.parametrize(
    "on",
    [
        (),
        ("actuator_delay", "coulomb_friction", "sensor_quantization"),
        ("elastic_transmission", "backlash"),
    ],
)
def test_compiling_changes_no_bit(name, on, tmp_path, monkeypatch):
    of = plant(name, tmp_path)
    compiled, as_text = rolled(of, on), kernel().py_func
    monkeypatch.setattr(kernels, "kernel", lambda: as_text)
    monkeypatch.setattr(kernels, "episode", kernels.roll_episode)
    assert np.array_equal(rolled(of, on), compiled)


@pytest.mark.parametrize("family", families())
def test_both_kernels_give_the_same_bits(family):
    rng, form = np.random.default_rng(3), families()[family]
    parameters, command = (
        rng.uniform(0.5, 2.0, (BLOCK, len(form.params))),
        rng.normal(size=(1, SAMPLES)),
    )
    h, steps = np.full((1, SAMPLES), 0.01), np.append(np.full((1, SAMPLES - 1), 1), [[0]], axis=1)
    alone = CompiledFamily(form).rollout(
        parameters, np.array([[0.3, -0.2]]), command[:, :, None], h, steps
    )
    dynamics = CompiledFamily(form)
    s = unobserved(Scheme(0.0, 1), np.arange(SAMPLES) * 0.01, command.T, np.ones(1), 0.01)
    p = np.repeat(dynamics.form.block.nulls[:, None], BLOCK, axis=1)
    p[: len(form.params)] = parameters.T
    off = np.zeros((len(effects()), 1), np.uint8)
    general = roll(
        s, dynamics.form, p, off, np.repeat(np.array([[0.3, -0.2]])[:, :, None], BLOCK, axis=2)
    )
    assert np.array_equal(np.moveaxis(general, 2, 0), alone[:, 0])


@pytest.mark.parametrize("effect", effects())
def test_an_effect_that_is_off_is_not_called(effect, tmp_path):
    of = plant("one joint", tmp_path)
    joints, form = 1, of.dynamics.form
    p = np.repeat(form.block.nulls[:, None], BLOCK, axis=1)
    p[list(form.block.rows(effect))] = np.nan  # would be seen wherever it is read
    s = unobserved(
        SYMMETRIC,
        np.arange(SAMPLES) * of.timestep_s,
        np.ones((SAMPLES, 1)),
        of.command_scales,
        of.timestep_s,
    )
    out = roll(s, form, p, np.zeros((len(effects()), joints), np.uint8), np.zeros((1, 2, BLOCK)))
    assert np.isfinite(out).all()


def test_a_delayed_command_is_its_mean_over_the_step():
    t, issued = np.arange(5) * 0.1, np.array([[0.0], [1.0], [3.0], [3.0], [0.0]])
    integral = np.concatenate([[[0.0]], np.cumsum(issued[:-1] * 0.1, axis=0)])
    signals, sent = np.zeros((len(SIGNALS_AT_JOINT), BLOCK)), np.zeros((1, BLOCK), np.int64)
    signals[LAG_S], signals[PAST] = 0.05, -2.0
    means = []
    for i in range(4):
        kernel_sample.send_late(
            0, t[i], t[i] + 0.1, 0.1, t, issued, integral, signals.ravel(), sent
        )
        means.append(signals[U, 0])
    assert means == pytest.approx([(-2.0 + 0.0) / 2, (0.0 + 1.0) / 2, (1.0 + 3.0) / 2, 3.0])


def test_a_late_sensor_shows_where_the_joint_was():
    t = np.arange(6) * 0.1
    signals = np.zeros((len(SIGNALS_AT_JOINT), BLOCK))
    passed, seen = np.zeros((6, 2, BLOCK)), np.zeros((1, BLOCK), np.int64)
    signals[LATE_S] = 0.15
    shown = []
    for i in range(6):  # along a cubic, which the interpolation keeps
        signals[Q], signals[V] = t[i] ** 3, 3 * t[i] ** 2
        kernel_sample.show_late(i, 0, t, signals.ravel(), passed, seen)
        shown.append(signals[Q_AT, 0])
    assert shown[2:] == pytest.approx(list((t[2:] - 0.15) ** 3), abs=1e-15)
