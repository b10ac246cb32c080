"""Clocks: stamps that are missing, repeated, at another rate, or on another clock.

- A gap is an interval of several periods, in which nobody knows what was commanded.
- Topics of one loop begin and end together. Where one begins and ends later than the other by the
  same time, its stamps are late.
- A message that was logged before it was stamped has a wrong stamp.
- A closed loop answers what its sensors showed. Where the noise of a position appears in the
  command before it appears in the position, the position's stamps are late.
"""

from __future__ import annotations

import numpy as np

from trueup.doctor.answers import answered_early_s
from trueup.doctor.finding import Fault, Finding
from trueup.doctor.log import Log
from trueup.doctor.mends import CutAtGaps, Shifted, gaps
from trueup.doctor.tuning import CLOCK
from trueup.episode.episode import GAP_PERIODS, Episode
from trueup.episode.omission import Omission, Reason
from trueup.model.clock import step_taken_s


def examine(log: Log) -> list[Finding]:
    """Findings of the clocks."""
    return [
        *_gaps(log),
        *_missing(log),
        *_not_finite(log),
        *_repeated_stamps(log),
        *_off_step(log),
        *_offset(log),
    ]


def _gaps(log: Log) -> list[Finding]:
    findings = []
    for e in log.episodes:
        for at in gaps(e):
            before, after = float(e.t_s[at - 1]), float(e.t_s[at])
            findings.append(
                Finding(
                    Fault.GAP,
                    None,
                    None,
                    (e.digest,),
                    1.0,
                    (
                        f"no sample for {after - before:.4g} s, "
                        f"{(after - before) / e.period_s:.0f} times the usual interval: the "
                        "command in between is not known"
                    ),
                    "Nothing is predicted across it: the recording is taken as two.",
                    (CutAtGaps((e.digest,), log.plant.horizon_s),),
                    from_s=before,
                    to_s=after,
                )
            )
    return findings


def _missing(log: Log) -> list[Finding]:
    """Samples that are missing from an even clock, one or a few at a time."""
    spoilt, lost, samples, first = [], 0, 0, None
    for e in log.episodes:
        spans = np.diff(e.t_s) / e.period_s
        if np.mean(np.abs(spans - np.rint(spans)) < CLOCK.jitter) < CLOCK.regular:
            continue
        long = (spans > CLOCK.missing_periods) & (spans <= GAP_PERIODS)
        missing = int(np.rint(spans[long] - 1.0).sum())
        if missing > CLOCK.missing * len(e.t_s):
            spoilt.append(e)
            lost, samples = lost + missing, samples + len(e.t_s)
            first = float(e.t_s[np.flatnonzero(long)[0]]) if first is None else first
    if not spoilt:
        return []
    return [
        Finding(
            Fault.MISSING_SAMPLES,
            None,
            None,
            tuple(e.digest for e in spoilt),
            1.0,
            f"{lost} samples are missing beside {samples} that are there",
            "Stamps are taken as they are, so nothing is shifted; look for an overloaded recorder.",
            from_s=first,
            applied=True,
        )
    ]


def _omissions(log: Log, reason: Reason) -> list[tuple[Episode, Omission]]:
    return [(e, o) for e in log.episodes for o in e.omissions if o.reason is reason]


def _not_finite(log: Log) -> list[Finding]:
    findings = []
    omitted = _omissions(log, Reason.NOT_FINITE)
    for name in dict.fromkeys(o.channel for _, o in omitted):
        mine = [(e, o) for e, o in omitted if o.channel == name]
        many = sum(o.messages for _, o in mine)
        samples = sum(len(e.t_s) for e, _ in mine)
        findings.append(
            Finding(
                Fault.MISSING_SAMPLES,
                name,
                None,
                tuple(e.digest for e, _ in mine),
                1.0,
                f"{many} messages have no finite number for {name}, beside {samples} samples",
                "The messages are left out; nothing is put in their place.",
                from_s=mine[0][1].from_s,
                to_s=mine[0][1].to_s,
                applied=True,
            )
        )
    return findings


def _repeated_stamps(log: Log) -> list[Finding]:
    omitted = _omissions(log, Reason.REPEATED_STAMP)
    if not omitted:
        return []
    many = sum(o.messages for _, o in omitted)
    topics = ", ".join(dict.fromkeys(o.topic for _, o in omitted))
    return [
        Finding(
            Fault.REPEATED_STAMPS,
            None,
            None,
            tuple(dict.fromkeys(e.digest for e, _ in omitted)),
            1.0,
            f"{many} messages on {topics} have the stamp of the message before",
            "The later one of two with one stamp is left out.",
            from_s=omitted[0][1].from_s,
            to_s=omitted[0][1].to_s,
            applied=True,
        )
    ]


def _off_step(log: Log) -> list[Finding]:
    declared = log.plant.timestep_s
    off = [
        e
        for e in log.episodes
        if abs(step_taken_s(e.period_s, declared) / declared - 1.0) > CLOCK.off_step
    ]
    if not off:
        return []
    period_s = off[0].period_s
    return [
        Finding(
            Fault.CLOCK_OFF_STEP,
            None,
            None,
            tuple(e.digest for e in off),
            1.0,
            (
                f"samples are {1e3 * period_s:.4g} ms apart, which is no whole number of the "
                f"declared steps of {1e3 * declared:.4g} ms"
            ),
            "Declare the step of the loop that recorded as nominal.timestep_s.",
        )
    ]


def _offset(log: Log) -> list[Finding]:
    """Observations whose stamps are late, or early, against those of commands."""
    late = [(e, s) for e in log.episodes if (s := _late_by_topics(e)) is not None]
    if late:
        return [
            _topic_offset(
                [e for e, _ in late],
                float(np.median([s for _, s in late])),
                0.95,
                "observations begin and end {} {} than commands, by the same time at both ends",
            )
        ]
    logged = [(e, s) for e in log.episodes if (s := _late_by_logging(e)) is not None]
    if logged:
        return [
            _topic_offset(
                [e for e, _ in logged],
                float(np.median([s for _, s in logged])),
                0.9,
                "messages were logged before they were stamped: the stamps of observations are {} "
                "{} than those of commands",
            )
        ]
    early = answered_early_s(log)
    if early is not None:
        return [
            _topic_offset(
                list(log.episodes),
                early,
                0.9,
                "the command answers the noise of the position before the position shows it, which "
                "is {} {}",
            )
        ]
    return []


def _topic_offset(episodes: list[Episode], late_s: float, sure: float, words: str) -> Finding:
    digests = tuple(e.digest for e in episodes)
    later, late, by = ("later", "late", "back") if late_s > 0.0 else ("earlier", "early", "forward")
    span = f"{1e3 * abs(late_s):.4g} ms"
    return Finding(
        Fault.TOPIC_OFFSET,
        None,
        None,
        digests,
        sure,
        words.format(span, later),
        f"Stamps of observations are {span} {late}: move them {by} by that.",
        (Shifted(digests, late_s),),
    )


def _late_by_topics(e: Episode) -> float | None:
    """By how much observations begin and end later than commands [s], where it is the same."""
    offset = e.offset
    if offset is None or abs(offset.observations - offset.commands) > 1:
        return None
    begin, end = offset.begin_s, offset.end_s
    if offset.observations == offset.commands + 1:  # the last command acts until the last sample
        end -= e.period_s
    elif offset.commands == offset.observations + 1:
        end += e.period_s
    mean = (begin + end) / 2.0
    apart = abs(begin - end)
    if abs(mean) <= CLOCK.offset_periods * e.period_s or apart > CLOCK.alike * abs(mean):
        return None
    return mean


def _late_by_logging(e: Episode) -> float | None:
    """By how much stamps of observations are later than those of commands [s], where one of the two
    was logged before it was stamped."""
    latency = e.offset.latency_s if e.offset is not None else None
    if latency is None or min(latency) > -CLOCK.early_s:
        return None
    return latency[1] - latency[0]
