"""Configuration: what a simulator's file says of each joint, and the text that it becomes."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import ceil, floor

from trueup.export.joint_drive import Drives, Ranged
from trueup.model.plant import Plant

DIGITS = 6  # of a number in a file
WIDTH = 96
MOST_TIED = 6  # pairs of numbers that a file names
GIVEN_UP = 1e-9  # of a step: rounding of a delay that is a whole number of them

Value = Ranged | float | int | list[str] | tuple[str, ...] | None


@dataclass(frozen=True, slots=True)
class Entry:
    """The configuration of one joint: a class of the simulator, its arguments in their order, and
    the command that the action is made of: force or position = scale x command + offset."""

    joint: str
    kind: str
    arguments: Mapping[str, Value]
    scale: float
    offset: float


def as_forces(plant: Plant) -> str:
    """How forces per unit of inertia become forces, in words."""
    if len(plant.joints) == 1:
        return "give the joint's with --inertia, or multiply them"
    return "multiply each joint's by its own, or let the simulator take `force`"


def heading(drives: Drives, version: str, more: Sequence[str]) -> list[str]:
    """Where a file comes from, and what is not certain, in lines."""
    lines = [f"{drives.plant.name}, artifact {drives.digest}, written by trueup {version}."]
    if drives.answer:
        lines += ["", *_wrapped(drives.answer)]
    for other in drives.alternatives:
        lines += ["", *_wrapped(f"The recordings cannot tell this from: {other}.")]
    if drives.inertia is not None:
        lines += ["", *_wrapped(f"Forces are for an inertia of {drives.inertia:g}.")]
    elif drives.is_per_inertia:
        lines += ["", *_wrapped(f"Forces are per unit of inertia: {as_forces(drives.plant)}.")]
    if drives.gravity:
        lines += [
            "",
            *_wrapped(
                f"The asset must hold the pendulum's gravity: {number(drives.gravity)} at a right "
                "angle."
            ),
        ]
    for note in more:
        lines += ["", *_wrapped(note)]
    for left in drives.left:
        lines += ["", *_wrapped(f"Not expressed: {left}.")]
    return lines


def notes(drives: Drives, step_s: float) -> list[str]:
    """What a simulator's file must say besides: what delays are counted in, and the springs that
    its asset must hold."""
    late = any(d["delay"].value for d in drives.drives)
    lines = [f"Delays are in physics steps of {1e3 * step_s:g} ms."] if late else []
    if drives.beside:
        lines.append(drives.beside)
    springs = [f"{d.joint} {number(d['spring'].value)}" for d in drives.drives if d["spring"].value]
    if springs:
        lines.append(
            "A passive spring acts beside the drive, which the asset must hold: "
            f"{', '.join(springs)}."
        )
    if drives.tied:
        lines.append(
            f"Off together, though drawn independently here: {', '.join(drives.tied[:MOST_TIED])}; "
            "the target `randomisation` draws them together."
        )
    return lines


def delay_steps(delay: Ranged, step_s: float) -> tuple[int, int]:
    """The fewest and the most steps of a delay [s]: its interval in whole steps, or the nearest one
    where that is narrower than a step."""
    if not delay.value:
        return 0, 0
    least, most = ceil(delay.low / step_s - GIVEN_UP), floor(delay.high / step_s + GIVEN_UP)
    if least > most:
        least = most = round(delay.value / step_s)
    return least, most


def python_module(
    title: str,
    docstring: Sequence[str],
    imports: Sequence[str],
    entries: Sequence[Entry],
    action: str,
    events: Iterable[str],
) -> str:
    """A Python module with ACTUATORS, ACTIONS and EVENTS. `docstring` follows its title;
    `action` says what an action's scale and offset make."""
    lines = [
        f'"""{title}',
        "",
        *docstring,
        '"""',
        "",
        *imports,
        "",
        *as_python("ACTUATORS", entries),
        "",
        f"# {action} is scale x command + offset",
        *actions(entries),
        "",
        "# each draws its numbers from their 95 % intervals, at every reset",
        "EVENTS = {",
        *events,
        "}",
    ]
    return "\n".join(lines) + "\n"


def event(name: str, function: str, params: Mapping[str, str]) -> Iterator[str]:
    """A term of EVENTS that calls a function at every reset, as lines of Python; `params` are code
    already."""
    yield f"    {json.dumps(name)}: EventTermCfg("
    yield f"        func={function},"
    yield '        mode="reset",'
    yield "        params={"
    for argument, code in params.items():
        yield f"            {json.dumps(argument)}: {code},"
    yield "        },"
    yield "    ),"


def bounds(value: Ranged) -> str:
    """The two ends of an interval, as Python."""
    return f"({number(value.low)}, {number(value.high)})"


def _wrapped(text: str) -> list[str]:
    lines, line = [], ""
    for word in text.split():
        if line and len(line) + len(word) >= WIDTH:
            lines.append(line)
            line = word
        else:
            line = f"{line} {word}".strip()
    return [*lines, line]


def number(value: float) -> str:
    """A number in Python and in YAML."""
    if value in (float("inf"), float("-inf")):
        return 'float("inf")'
    text = f"{value:.{DIGITS}g}"
    return text if any(c in text for c in ".en") else f"{text}.0"


def interval(value: Value) -> str:
    """The 95 % interval of a number in words, `` where it has none."""
    if not isinstance(value, Ranged) or value.is_certain:
        return ""
    return f"95 %: {number(value.low)} to {number(value.high)}"


def literal(value: Value) -> str:
    """A value as Python."""
    if isinstance(value, Ranged):
        return number(value.value)
    if isinstance(value, float):
        return number(value)
    if isinstance(value, tuple):
        return f"({json.dumps(list(value))[1:-1]},)"
    return "None" if value is None else json.dumps(value)


def as_python(name: str, entries: Sequence[Entry]) -> Iterator[str]:
    """A dict of entries by joint, as lines of Python."""
    yield f"{name} = {{"
    for entry in entries:
        yield f"    {json.dumps(entry.joint)}: {entry.kind}("
        for argument, value in entry.arguments.items():
            remark = interval(value)
            yield f"        {argument}={literal(value)}," + (f"  # {remark}" if remark else "")
        yield "    ),"
    yield "}"


def actions(entries: Sequence[Entry]) -> Iterator[str]:
    """What the action of each joint is made of, as lines of Python."""
    yield "ACTIONS = {"
    for entry in entries:
        numbers = f'"scale": {number(entry.scale)}, "offset": {number(entry.offset)}'
        yield f"    {json.dumps(entry.joint)}: {{{numbers}}},"
    yield "}"


def as_yaml(name: str, entries: Sequence[Entry]) -> Iterator[str]:
    """Entries by joint, as lines of YAML."""
    yield f"{name}:"
    for entry in entries:
        yield f"  {entry.joint}:"
        yield f"    class: {entry.kind}"
        for argument, value in entry.arguments.items():
            remark = interval(value)
            text = _yaml(value)
            yield f"    {argument}: {text}" + (f"  # {remark}" if remark else "")


def _yaml(value: Value) -> str:
    if isinstance(value, Ranged):
        value = value.value
    if isinstance(value, float):
        return ".inf" if value == float("inf") else number(value)
    return json.dumps(value)
