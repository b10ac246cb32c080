"""What acts at each port, compiled: one small function for a port, which calls the effects there in
their order.

They are written from the signatures of the effects' and families' `apply` and `acceleration`, a
loop over the lanes for each, entered only where the effect acts. So a hypothesis costs what its own
effects cost, nothing is compiled for it, and a new effect is one new file.

    begin          hidden states as they were before the log
    delays         transport delays [s]; whether there are any
    timing         the length of a step
    command        the command that an actuator gets
    goal           the same of a servo of position: what changes its goal
    drive          what changes its drive, which acts on the error
    nominal        acceleration of a family, and its parts where an effect asks for them
    force          forces, as accelerations
    answer         forces that answer all others at their joint
    friction       levels of dry friction
    observe        what sensors show
    follow         hidden states of a lane, copied to another
    correct        hidden states of a lane that an observation corrects
    jump           hidden states that a window's start sets

Every port gets the number `j` of a joint; `signals` `(joints, SIGNALS_AT_JOINT x lanes)`; `common`,
the signals that all joints share, `(SIGNALS_OF_ALL x lanes,)`; `memory`, the effects' hidden
states, `(joints, states x lanes)`; `on` `(effects, joints)`, which effects act; and `p` `(joints,
parameters x lanes)`, their parameters. What a joint has lies in one row: of numbers that are a
known distance apart the compiler sees that they are not the same, and takes several lanes at
once.
"""

from __future__ import annotations

import inspect
import linecache
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from numba.extending import register_jitable

from trueup.model.block import BLOCK, memory_offsets, offsets
from trueup.model.effect import DELAYS, SIGNALS, Effect, Port, effects
from trueup.model.family import Family, families, source_digest
from trueup.model.joint_effects import PARTS, answers_all

# ports inside a step, where a position is the one at which the step acts
WITHIN = Port.FORCE, Port.FRICTION, Port.OBSERVATION
GIVEN = "j, signals, common, memory, on, p"  # what a port is called with


SIGNALS_AT_JOINT = (
    "q", "v",
    "u",  # the command on its way to the joint
    "a",  # acceleration
    "level",  # of dry friction, as an acceleration
    "q_at", "v_at",  # where a step acts, or what a sensor shows
    "passive", "drive", "spring", "mobility",  # parts of the nominal acceleration
    "lag_s", "late_s",  # transport delays of the command and of the sensor [s]
    "past",  # the command before the log began
    "u_scale",  # the command's declared limit
)  # fmt: skip
SIGNALS_OF_ALL = (
    "h",  # step [s]
    "t",  # since the episode began [s]
    "since",  # the last sample [s]
    "period",  # of the samples [s]
    "implicit",  # 1 where a step takes its end's values, 0 where it takes its middle's
)
(Q, V, U, A, LEVEL, Q_AT, V_AT, PASSIVE, DRIVE, SPRING, MOBILITY, LAG_S, LATE_S, PAST, U_SCALE) = (
    range(len(SIGNALS_AT_JOINT))
)
(H, T, SINCE, PERIOD, IMPLICIT) = range(len(SIGNALS_OF_ALL))


def at(signal: Any, lane: Any) -> Any:
    """Where a lane of a signal is."""
    return signal * BLOCK + lane


register_jitable(at)  # compiled into what calls it


def memories() -> dict[tuple[str, str], int]:
    """The place of each effect's hidden states in a block's memory."""
    return {
        key: i for i, key in enumerate((e.name, s) for e in effects().values() for s in e.states)
    }


def digest() -> str:
    """Digest of what the ports are made of: compiled code is kept only as long as its text."""
    made_of = [f.acceleration for f in families().values()] + [e.apply for e in effects().values()]
    return ",".join(source_digest(f) for f in (*made_of, digest))


def _made(name: str, arguments: str, body: Iterable[str], returns: str = "") -> Callable[..., Any]:
    """A function of this text, which tracebacks and debuggers can show."""
    lines = [*body] or ["pass"]
    if arguments.startswith(GIVEN):
        lines = ["here, kept, own = signals[j], memory[j], p[j]", *lines]
    text = "\n".join(
        [
            f"def {name}({arguments}):",
            *(f"    {line}" for line in lines),
            *([f"    return {returns}"] if returns else []),
            "",
        ]
    )
    where = f"<port {name}>"
    linecache.cache[where] = len(text), None, text.splitlines(keepends=True), where
    scope: dict[str, Any] = dict(FUNCTIONS)
    exec(compile(text, where, "exec"), scope)  # noqa: S102  (written here, from the signatures of our own files)
    function: Callable[..., Any] = register_jitable(forceinline=True)(scope[name])
    return function


def _all(of: Callable[[int, type[Effect]], Iterable[str]]) -> Iterator[str]:
    """Lines for every effect, in the order in which they act."""
    for index, effect in enumerate(effects().values()):
        yield from of(index, effect)


def _at(port: Port) -> Iterator[str]:
    """A port's own effects."""
    return _all(
        lambda i, e: _loop(i, e) if e.port is port and not e.delays() and not answers_all(e) else ()
    )


def _any_on(asks: Callable[[type[Effect]], bool]) -> str:
    """Whether any of those effects acts that ask for something."""
    return (
        " or ".join(f"on[{i}].any()" for i, e in enumerate(effects().values()) if asks(e))
        or "False"
    )


def _loop(index: int, effect: type[Effect]) -> list[str]:
    """One effect's loop over the lanes of a joint."""
    rows = dict(zip((n.name for n in effect.params), offsets()[effect.name], strict=True))
    within = {"q": "q_at", "v": "v_at", "lag_s": "late_s"} if effect.port in WITHIN else {}

    def value(name: str) -> str:
        if name in rows:
            return f"own[{rows[name] * BLOCK} + lane]"
        return _state(effect, name) if name in effect.states else _signal(within.get(name, name))

    changed = [
        _signal(within.get(name, name))
        for name in (DELAYS if effect.delays() else SIGNALS[effect.port])
    ]
    results = ", ".join([*changed, *(_state(effect, name) for name in effect.states)])
    given = ", ".join(value(name) for name in inspect.signature(effect.apply).parameters)
    sign = "+=" if effect.port is Port.FRICTION else "="
    keeps_past = "past" in effect.states and not within
    return [
        f"if on[{index}, j]:",
        f"    for lane in range({BLOCK}):",
        f"        {results} {sign} {effect.name}({given})",
        *([f"        {_signal('past')} = {_state(effect, 'past')}"] if keeps_past else []),
    ]


def _signal(name: str) -> str:
    """A signal as the compiled text names it."""
    if name in SIGNALS_OF_ALL:
        return f"common[{SIGNALS_OF_ALL.index(name) * BLOCK} + lane]"
    return f"here[{SIGNALS_AT_JOINT.index(name) * BLOCK} + lane]"


def _state(effect: type[Effect], name: str, lane: str = "lane") -> str:
    """A hidden state."""
    return f"kept[{memories()[effect.name, name] * BLOCK} + {lane}]"


def _begin(_: int, effect: type[Effect]) -> Iterator[str]:
    for state, begins in zip(effect.states, effect.begins, strict=True):
        if begins != "first":
            usual = "" if begins == "zero" else f"{_signal(begins)} + "
            yield f"for lane in range({BLOCK}):"
            yield (
                f"    {_state(effect, state)} = {usual}"
                f"own[{memory_offsets()[effect.name, state] * BLOCK} + lane]"
            )


def _follow(_: int, effect: type[Effect]) -> list[str]:
    return [
        f"{_state(effect, state)} = {_state(effect, state, 'other')}" for state in effect.states
    ]


def _correct(index: int, effect: type[Effect]) -> list[str]:
    if not effect.hides_velocity:
        return []
    hidden, before = (_state(effect, state) for state in effect.states)
    return [
        f"if on[{index}, j]:",
        f"    {hidden} += by_hidden * missed",
        f"    {before} += by_velocity * missed",
    ]


def _jump(index: int, effect: type[Effect]) -> list[str]:
    if not effect.hides_velocity:
        return []
    before = _state(effect, effect.states[1])
    return [
        f"if on[{index}, j]:",
        f"    for lane in range({BLOCK}):",
        f"        {before} += set_to[lane] - {_signal('v')}",
    ]


def _family(number: int, family: type[Family]) -> list[str]:
    """One family's loop over the lanes; its parts are told apart only where an effect asks for
    them."""
    values = "".join(f", own[{j * BLOCK} + lane]" for j in range(len(family.params)))
    q, v, u, a, passive, spring, drive = (
        _signal(x) for x in ("q_at", "v_at", "u", "a", "passive", "spring", "drive")
    )
    acceleration = f"{family.name}({q}, {v}, {u}{values})"
    return [
        f"if number == {number}:",
        f"    for lane in range({BLOCK}):",
        f"        {v} += alpha * {_signal('h')} * {acceleration}",
        f"        {a} = {acceleration}",
        "    if parts:",
        f"        for lane in range({BLOCK}):",
        f"            {passive} = {family.name}({q}, {v}, 0.0{values})",
        f"            {spring} = {family.name}({q}, 0.0, 0.0{values})",
        f"            {drive} = {a} - {passive}",
    ]


FUNCTIONS = {e.name: register_jitable(e.apply) for e in effects().values()}
FUNCTIONS |= {f.name: register_jitable(f.acceleration) for f in families().values()}

begin = _made("begin", GIVEN, _all(_begin))
delays = _made(
    "delays",
    GIVEN,
    [
        "any_on = False",
        *_all(
            lambda i, e: [*_loop(i, e), f"any_on = any_on or on[{i}, j] != 0"] if e.delays() else ()
        ),
    ],
    "any_on",
)
timing = _made("timing", GIVEN, _at(Port.TIMING))
command = _made("command", GIVEN, _at(Port.COMMAND))
goal = _made(
    "goal",
    GIVEN,
    _all(
        lambda i, e: (
            _loop(i, e) if e.port is Port.COMMAND and not e.delays() and not e.of_drive else ()
        )
    ),
)
drive = _made(
    "drive",
    GIVEN,
    _all(
        lambda i, e: _loop(i, e) if e.port is Port.COMMAND and not e.delays() and e.of_drive else ()
    ),
)
nominal = _made(
    "nominal",
    "here, common, own, number, alpha, parts",
    [line for i, f in enumerate(families().values()) for line in _family(i, f)],
)
force = _made("force", GIVEN, _at(Port.FORCE))
answer = _made("answer", GIVEN, _all(lambda i, e: _loop(i, e) if answers_all(e) else ()))
friction = _made("friction", GIVEN, _at(Port.FRICTION))
observe = _made("observe", GIVEN, _at(Port.OBSERVATION))
follow = _made("follow", f"{GIVEN}, other, lane", _all(_follow))
correct = _made("correct", f"{GIVEN}, by_velocity, by_hidden, missed, lane", _all(_correct))
jump = _made("jump", f"{GIVEN}, set_to", _all(_jump))
parts_asked = _made(
    "parts_asked", "on", (), _any_on(lambda e: bool(PARTS.intersection(e.arguments())))
)
answers_asked = _made("answers_asked", "on", (), _any_on(answers_all))
