"""Series in windows, and rollouts of hypotheses over them with some lanes moved a little."""

import numpy as np

from trueup.model.block import BLOCK, FILTERS
from trueup.model.effect import effects
from trueup.model.hypothesis import begun, switches
from trueup.model.roll import roll_parts
from trueup.model.series import Scheme, Series, integral_of
from trueup.model.stack import RolloutOf, Stack

FOLLOWING = 2  # lanes that begin each window with what the first remembers


def series_of(commands, observed, period_s, u_scale, begins=0, every=100):
    """Returns commands `(samples, joints)` and what was observed under them as a series, with a
    window at every so many samples from the first that begins one."""
    samples, states = observed.shape
    t = np.asarray(np.arange(samples) * period_s)
    t.flags.writeable = False
    resets = np.full(samples, -1)
    resets[begins::every] = np.arange(len(resets[begins::every]))
    windows = int((resets >= 0).sum())
    steps = np.ones(samples, np.int64)
    steps[-1] = 0
    return Series(
        t_s=t,
        h_s=np.full(samples, period_s),
        steps=steps,
        issued=commands,
        rise=np.zeros_like(commands),
        integral=integral_of(commands, t),
        observed=observed,
        usable=np.ones(observed.shape, np.bool_),
        window_of=np.cumsum(resets >= 0) - 1,
        resets=resets,
        digest="series",
        scheme=Scheme(0.5, 1),
        begin=np.zeros((windows, states)),
        begin_by_positions=np.zeros((windows, states)),
        period_s=period_s,
        u_scale=np.array(u_scale),
    )


def rolled(form, parameters, hypothesis, s, sizes, gain=None, moved=()):
    """Returns what is observed in the rollout that `asked` asks for: in each lane, or in that of a
    filter and in the one that starts windows from it."""
    of = asked(form, parameters, hypothesis, s, sizes, gain, moved)
    on = switches(hypothesis, form.block.joints)
    (out,) = roll_parts(form, on, of, lambda _, out: out)
    return out if gain is None else out[:, :, [0, FILTERS]]


def asked(form, parameters, hypothesis, s, sizes, gain=None, moved=()):
    """Returns what is asked of a rollout of a hypothesis whose starts, pasts and `moved` parameters
    are a little off in some lanes; where a filter has a `gain`, in none."""
    block = form.block
    values = block.nulls.copy()
    values[: len(parameters)] = parameters
    for term in hypothesis.effects:
        starts = effects()[term.partition("@")[0]].starts
        begin = [0.5 * x for x in starts[len(starts) // 2]]
        values = begun(block, values, sizes, term, begin)
    p = np.repeat(values[:, None], BLOCK, axis=1)
    states = 2 * block.joints
    init = 0.5 * np.random.default_rng(2).normal(size=(len(s.begin), states, 1)) + np.zeros(BLOCK)
    if gain is None:
        init[:, 0, 1] += 1e-3
        init[:, -1, 2] += 1e-3
        p[list(moved), range(3, 3 + len(moved))] *= 1.01
        for key, row in block.memories.items():
            p[row, 6] += 0.1 if key[0] in hypothesis.effects else 0.0
    if gain is None:
        return RolloutOf(Stack.of([s]), p[None], init, starts=FOLLOWING)
    return RolloutOf(Stack.of([s]), p[None], init[:1], gain[..., None])


def together(each):
    """Returns what is asked of several stacks as asked of one."""
    first = each[0]
    stack = Stack.of([s for of in each for s in of.stack])
    p, init = (np.concatenate([getattr(of, name) for of in each]) for name in ("p", "init"))
    return RolloutOf(stack, p, init, first.gains, first.starts)
