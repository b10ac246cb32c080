"""Guess a mapping: which signals of a recording are the position, the velocity and the command.

Names decide, and the fields of messages. What was told explicitly is taken as it is; what only a
preference or a usual unit decided is marked as guessed, to be shown to a person.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trueup.episode.layout import Channel, Field, Layout
from trueup.episode.units import ANGLES, LENGTHS, spelled
from trueup.errors import BadMapping
from trueup.recording.asked import NOTHING_ASKED, Asked, check
from trueup.recording.controllers import joints_at
from trueup.recording.guess_clock import best, clock_of, signals_in_words
from trueup.recording.mapping import Part, SignalMapping, Source
from trueup.recording.quantity import Quantity, quantity_of, words
from trueup.recording.recording import Clock, Recording, Signal, Stream
from trueup.recording.table import TableRecording

TURNS = 4.0 * np.pi  # [rad] beyond two turns a joint's angle is taken to be in degrees


def guess(
    recording: Recording,
    asked: Asked = NOTHING_ASKED,
    *,
    joints: Sequence[str] | None = None,
    layout: Layout | None = None,
) -> SignalMapping:
    """The mapping of a recording, of one joint, or of these `joints`, or for the channels of a
    declared `layout`. Raises BadMapping where names do not decide."""
    return _Guess(recording, asked, layout).mapping(joints)


class _Guess:
    def __init__(self, recording: Recording, asked: Asked, layout: Layout | None) -> None:
        self._recording, self._asked, self._layout = recording, asked, layout
        self._all = [
            quantity_of(s, _with_name(s, x, joints_at(s.name, asked.controllers) or asked.names))
            for s in recording.streams
            for x in s.signals
        ]
        self._head = recording.head() if isinstance(recording, TableRecording) else {}
        check(asked)
        for name in (asked.observation, asked.command):
            if name is not None and recording.stream(name) is None:
                raise self._refused(f"no signal is on {name}", "topics")
        self._clock: Clock | None = None
        self._is_clock_guessed = False
        if isinstance(recording, TableRecording):
            self._clock, self._is_clock_guessed = clock_of(recording, self._all, asked.clock)

    def mapping(self, joints: Sequence[str] | None) -> SignalMapping:
        if joints is None:
            of = self._layout_joints() if self._layout else [self._joint()]
        else:
            of = list(joints)
        sources: list[Source] = []
        for joint in of:
            sources += self._of_joint(joint, is_only=len(of) == 1)
        return SignalMapping(tuple(sources), self._clock, self._is_clock_guessed)

    def _layout_joints(self) -> list[str | None]:
        assert self._layout is not None
        return list(dict.fromkeys(c.joint for c in self._layout.observations))

    # -- one joint

    def _of_joint(self, joint: str | None, *, is_only: bool) -> list[Source]:
        of = [q for q in self._all if not q.is_time and self._is_of(q, joint, is_only=is_only)]
        position = self._observed(of, Field.POSITION, "q", joint)
        beside = [q for q in of if q.stream == position[0].stream] or of
        velocity = self._velocity(beside, position[0], joint)
        command = self._commanded(of, position[0], joint)
        sources = [
            self._source(Part.OBSERVATIONS, Field.POSITION, "q", *position, joint),
            *(
                [self._source(Part.OBSERVATIONS, Field.VELOCITY, "v", *velocity, joint)]
                if velocity
                else []
            ),
        ]
        if command is not None:
            chosen, how = command
            sources.append(
                self._source(Part.COMMANDS, chosen.field or Field.EFFORT, "u", chosen, how, joint)
            )
            sources += self._besides(of, beside, chosen, joint)
        return sources

    def _is_of(self, q: Quantity, joint: str | None, *, is_only: bool) -> bool:
        if joint is None or q.signal.name in self._asked.signals.values():
            return True
        if q.joint is None:
            return is_only
        return _plain(q.joint) == _plain(joint) or (is_only and self._is_loose(q))

    def _is_loose(self, q: Quantity) -> bool:
        """Whether a signal may be of the one joint although its name says another word: where no
        message says its joint, and no second joint is seen."""
        joints = {x.joint for x in self._all if x.field is Field.POSITION and x.joint is not None}
        return q.signal.joint is None and len(joints) <= 1

    def _observed(
        self, of: Sequence[Quantity], wanted: Field, symbol: str, joint: str | None
    ) -> tuple[Quantity, tuple[str, ...]]:
        """The position of a joint, and what of it is a guess."""
        if symbol in self._asked.signals:
            return self._named(symbol), ()
        seen = [q for q in of if q.field is wanted and self._may_be_observed(q)]
        how: tuple[str, ...] = ()
        if not seen:  # a vector of states whose entries have no names
            seen = [q for q in of if q.field is None and q.is_measured and not q.is_command]
            how = ("signal",)
        likely = best(seen, lambda q: (self._by_layout(q, wanted), q.is_measured, _first(q)))
        if len(likely) != 1:
            what = f"{len(likely)} signals look like the {wanted}"
            raise self._refused(what + (f" of {joint}" if joint else ""), symbol)
        return likely[0], how or (("signal",) if len(seen) > 1 and self._is_table else ())

    def _may_be_observed(self, q: Quantity) -> bool:
        if self._asked.observation is not None:
            return q.stream == self._asked.observation
        return not q.is_command and q.stream != self._asked.command

    def _velocity(
        self, beside: Sequence[Quantity], position: Quantity, joint: str | None
    ) -> tuple[Quantity, tuple[str, ...]] | None:
        if "v" in self._asked.signals:
            return (self._named("v"), ()) if self._asked.signals["v"] else None
        if self._layout is not None and not any(
            c.field is Field.VELOCITY and c.joint in (None, joint)
            for c in self._layout.observations
        ):
            return None
        seen = [
            q
            for q in beside
            if q.field is Field.VELOCITY
            and self._may_be_observed(q)
            and q.stream == position.stream
            and _phase(q) == _phase(position)
        ]
        likely = best(
            seen, lambda q: (self._by_layout(q, Field.VELOCITY), q.is_measured, _first(q))
        )
        if not likely:
            return None
        return likely[0], ("signal",) if len(likely) > 1 else ()

    def _commanded(
        self, of: Sequence[Quantity], position: Quantity, joint: str | None
    ) -> tuple[Quantity, tuple[str, ...]] | None:
        if "u" in self._asked.signals:
            return self._named("u"), ()
        declared = self._declared_command(joint)
        if self._layout is not None and declared is None:
            return None
        others = [q for q in of if q.signal is not position.signal]
        marked = [q for q in others if self._may_command(q) and (q.field or q.is_command)]
        nameless = self._nameless()
        if not marked and nameless and joint is not None:
            raise BadMapping(
                f"{self._recording.name}: the {nameless[1]} entries of {nameless[0]} have no names",
                field="commands",
                hint="Name their joints in their order with --names j1,j2 or --controllers (in "
                "Python names=), or one entry by its number with --signal.u 0.",
            )
        if not marked:  # what the drives measured is all that the log has of the command
            marked = [q for q in others if q.field is Field.EFFORT and not _is_applied(q)]
        if declared is not None:
            marked = [q for q in marked if q.field in (declared.field, None)] or marked
        likely = best(marked, lambda q: (self._by_command(q, declared), _strength(q), _first(q)))
        if len(likely) != 1:
            raise self._refused(
                f"{len(likely)} signals look like the command" + (f" of {joint}" if joint else ""),
                "u",
            )
        chosen = likely[0]
        if chosen.field is None:
            is_target = position.field is None and _phase(chosen) != "output"
            chosen = replace(chosen, field=Field.POSITION if is_target else Field.EFFORT)
        streams = {q.stream for q in marked}
        is_plain = chosen.signal.field is not None or len(marked) == 1
        return chosen, () if is_plain and len(streams) == 1 else ("signal",)

    def _nameless(self) -> tuple[str, int] | None:
        """The topic of commands whose entries have no names, and how many they are."""
        of = [
            q
            for q in self._all
            if self._may_command(q) and q.signal.joint is None and q.signal.name.isdigit()
        ]
        return (of[0].stream, len(of)) if of else None

    def _may_command(self, q: Quantity) -> bool:
        if self._asked.command is not None:
            return q.stream == self._asked.command
        return q.is_command and not _is_applied(q)

    def _by_command(self, q: Quantity, declared: Channel | None) -> bool:
        if declared is None or self._layout is None:
            return False
        return q.signal.name == declared.name or q.stream == self._layout.command_topic

    def _by_layout(self, q: Quantity, wanted: Field) -> bool:
        if self._layout is None:
            return False
        named = [c.name for c in self._layout.observations if c.field is wanted]
        return q.signal.name in named or q.stream == self._layout.observation_topic

    def _declared_command(self, joint: str | None) -> Channel | None:
        if self._layout is None:
            return None
        return next((c for c in self._layout.commands if c.joint in (None, joint)), None)

    def _besides(
        self,
        of: Sequence[Quantity],
        beside: Sequence[Quantity],
        command: Quantity,
        joint: str | None,
    ) -> list[Source]:
        """What the drive reports to have applied, and the effort that was measured with the
        position, where the log has them."""
        applied = [q for q in of if _is_applied(q) and q.field is command.field]
        measured = [
            q
            for q in beside
            if q.field is Field.EFFORT
            and not q.is_command
            and not _is_applied(q)
            and q.signal is not command.signal
        ]
        sources = []
        if len(applied) == 1:
            chosen = command.field or Field.EFFORT
            sources.append(self._source(Part.APPLIED, chosen, "u", applied[0], (), joint))
        if len(measured) == 1:
            sources.append(self._source(Part.EFFORTS, Field.EFFORT, "", measured[0], (), joint))
        return sources

    def _source(
        self,
        part: Part,
        of: Field,
        symbol: str,
        q: Quantity,
        how: tuple[str, ...],
        joint: str | None,
    ) -> Source:
        unit, is_told = self._unit(part, of, symbol, q)
        named = joint or q.signal.joint or (q.joint if self._layout is None else None)
        guessed = how if is_told else (*how, "unit")
        return Source(part, of, q.signal.name, q.stream, named, unit, guessed=guessed)

    # -- units

    def _unit(self, part: Part, of: Field, symbol: str, q: Quantity) -> tuple[str, bool]:
        """The unit of a signal, and whether somebody told it."""
        if part is Part.COMMANDS and of is Field.POSITION and "u" not in self._asked.units:
            symbol = "q"  # a goal is in the unit of what it is a goal for
        if symbol in self._asked.units:
            return spelled(self._asked.units[symbol]), True
        if q.unit is not None or part is Part.EFFORTS:
            return q.unit or "", True
        by_message = q.signal.field is not None  # JointState and its like are in SI
        if self._layout is not None:
            return "", by_message or part is Part.COMMANDS
        if of is Field.EFFORT:
            return "N·m" if by_message else "", True
        angle = self._angle(q if of is Field.POSITION else None)
        return angle if of is Field.POSITION else f"{angle}/s", by_message

    def _angle(self, q: Quantity | None) -> str:
        """The unit of positions that somebody or a recording's names or reach tell: rad, deg or
        m."""
        positions = [x for x in self._all if x.field is Field.POSITION]
        units = (spelled(self._asked.units.get("q", "")), *(x.unit for x in positions))
        named = next((unit for unit in units if unit in (*ANGLES, *LENGTHS)), None)
        if named is not None:
            return "m" if named in LENGTHS else named
        if isinstance(self._recording, TableRecording) and self._recording.angles:
            return self._recording.angles
        for other in [q] if q is not None else positions[:1]:
            reach = self._head.get(other.signal.name)
            if reach is not None and np.nanmax(np.abs(np.asarray(reach, float))) > TURNS:
                return "deg"
        return "rad"

    @property
    def _is_table(self) -> bool:
        return isinstance(self._recording, TableRecording)

    # -- what was asked for

    def _named(self, symbol: str) -> Quantity:
        name = self._asked.signals[symbol]
        topics = {"u": self._asked.command}.get(symbol, self._asked.observation)
        named = [q for q in self._all if q.signal.name == name and topics in (None, q.stream)]
        if len(named) != 1:
            raise self._refused(f"{len(named)} signals are named {name!r}", symbol)
        return named[0]

    def _joint(self) -> str | None:
        """The one joint that is meant. Raises BadMapping where there are several."""
        if "q" in self._asked.signals:
            named = self._named("q")
            return self._asked.joint or named.signal.joint or named.joint
        moved = [
            q
            for q in self._all
            if q.field is Field.POSITION and self._may_be_observed(q) and not q.is_time
        ]
        joints = list(dict.fromkeys(q.joint for q in moved if q.joint is not None))
        asked = self._asked.joint
        if asked is not None:
            if _plain(asked) not in map(_plain, joints):
                raise self._refused(
                    f"no joint {asked!r} is observed",
                    "joint",
                    f"There are {', '.join(joints)}."
                    if joints
                    else "No signal's name tells a joint: leave --joint out.",
                )
            return next(j for j in joints if _plain(j) == _plain(asked))
        if len(joints) > 1:
            raise self._refused(
                f"the log moves {len(joints)} joints, and a family describes one",
                "joint",
                f"Name one with --joint (in Python joint=): {', '.join(joints)}. Or describe the "
                "robot by an MJCF or a URDF, which --model names, or by a simulator with `joints`.",
            )
        return joints[0] if joints else None

    def _refused(self, what: str, field_: str, hint: str | None = None) -> BadMapping:
        option = {
            "q": "--signal.q (in Python q=)",
            "v": "--signal.v (in Python v=)",
            "u": "--signal.u (in Python u=)",
        }.get(field_, "--observation and --command")
        return BadMapping(
            f"{self._recording.name}: {what}",
            field=field_,
            hint=hint or f"Name it with {option}. {signals_in_words(self._recording)}",
        )


def _with_name(stream: Stream, signal: Signal, names: Sequence[str]) -> Signal:
    """A signal with its joint, where it is an entry of a list that has no names of its own."""
    index = signal.name.rpartition("/")[2]
    if not stream.is_clocked or signal.joint is not None or not index.isdigit():
        return signal
    return replace(signal, joint=names[int(index)]) if int(index) < len(names) else signal


PHASES = {"output": 2, "reference": 1, "feedback": 1, "desired": 0, "actual": 0}


def _phase(q: Quantity) -> str:
    """The part of a controller's state that a signal stands in."""
    return next((w for w in words(q.signal.name) if w in PHASES), "")


def _first(q: Quantity) -> int:
    """Of a message that tells one thing twice, the field that is not deprecated."""
    return PHASES.get(_phase(q), 0)


def _strength(q: Quantity) -> int:
    """How likely a signal is the command: an effort before a position before a velocity."""
    order = {Field.EFFORT: 3, Field.POSITION: 2, Field.VELOCITY: 1}
    return order[q.field] if q.field is not None else 0


def _is_applied(q: Quantity) -> bool:
    return "applied" in q.signal.name.lower() or "applied" in q.stream.lower()


def _plain(name: str) -> str:
    """A joint's name without what spellings differ in."""
    return "".join(c for c in name.lower() if c.isalnum())
