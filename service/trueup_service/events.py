"""Events: what the audit log tells, for those who want to hear of it as it happens.

An event is an entry of the log, written as a CloudEvent (version 1.0) or as a message for Slack.
Its id names the log and the entry, so that whoever receives it twice can tell.
Source: CloudEvents 1.0.2, section "Context Attributes", with the extensions "partitioning" and
"sequence"; the JSON event format; Slack's `mrkdwn`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any
from urllib.parse import quote

from trueup.canonical import Json
from trueup.ledger.audit import AuditEntry

SEQUENCE_DIGITS = 20  # so that the order of the text is the order of the log
SHORT = 12  # digits of a digest that people read
TESTED = "webhook:tested"


class EventName(StrEnum):
    """What somebody can be told of."""

    EPISODE = "episode"
    ALARM = "alarm"
    DIAGNOSIS = "diagnosis"
    DECISION = "decision"
    PROMOTION = "promotion"
    ROLLBACK = "rollback"
    TEST = "test"  # sent when it is asked for, whatever was selected


@dataclass(frozen=True, slots=True)
class Event:
    """What happened: the CloudEvents `type`, the facts for programs, a sentence for people, and the
    page that shows it, as a path."""

    name: EventName
    type: str
    entry: AuditEntry
    data: Mapping[str, Json]
    text: str
    page: str


def event_of(entry: AuditEntry) -> Event | None:
    """The event that an entry of the log is, None where nobody can be told of it."""
    make = _MAKERS.get(entry.kind)
    return None if make is None else make(entry, dict(entry.facts))


def cloud_event(event: Event, log: str, public_url: str | None) -> dict[str, Json]:
    """An event of the log of this name as a CloudEvent, in the JSON event format."""
    entry = event.entry
    data: dict[str, Json] = {
        "sequence": entry.sequence,
        "plant": entry.plant,
        "actor": entry.actor,
        "text": event.text,
        **event.data,
    }
    if public_url is not None:
        data["page"] = public_url.rstrip("/") + event.page
    document: dict[str, Json] = {
        "specversion": "1.0",
        "id": event_id(entry, log),
        "source": f"urn:trueup:log:{quote(log, safe='')}",
        "type": event.type,
        "subject": entry.subject,
        "time": entry.at,
        "sequence": f"{entry.sequence:0{SEQUENCE_DIGITS}d}",
        "datacontenttype": "application/json",
        "data": data,
    }
    if entry.plant is not None:
        document["partitionkey"] = entry.plant
    return document


def slack_message(event: Event, public_url: str | None) -> dict[str, Json]:
    """An event as a message for Slack, or what takes the same."""
    text = _escaped(event.text)
    if public_url is not None:
        text += f" (<{public_url.rstrip('/')}{event.page}|open>)"
    plant = event.entry.plant
    return {"text": text if plant is None else f"*{_escaped(plant)}*: {text}"}


def event_id(entry: AuditEntry, log: str) -> str:
    """The id of the event that an entry of the log of this name is."""
    return f"{log}-{entry.sequence}"


def _escaped(text: str) -> str:
    """Text in which nothing is a link or calls anybody."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def _episode(entry: AuditEntry, facts: dict[str, Any]) -> Event:
    data = {
        "episode": entry.subject,
        "role": facts["role"],
        "size_bytes": facts["size_bytes"],
        "conditions": facts["conditions"],
    }
    text = f"{entry.actor} uploaded the {facts['role']} episode {entry.subject[:SHORT]}"
    page = f"/plants/{entry.plant}/episodes/{entry.subject}"
    return Event(EventName.EPISODE, "trueup.episode.ingested", entry, data, text, page)


def _alarm_raised(entry: AuditEntry, facts: dict[str, Any]) -> Event:
    data = {
        "alarm": entry.subject,
        "monitor": facts["monitor"],
        "episode": facts["episode"],
        "change": facts["alarm"],
    }
    cause = "a scheduled validation" if facts["monitor"] is None else "the monitor"
    alarm, episode = entry.subject[:SHORT], facts["episode"][:SHORT]
    text = f"{cause} raised the alarm {alarm} on the episode {episode}"
    return _alarm(entry, "trueup.alarm.raised", data, text)


def _alarm_closed(entry: AuditEntry, facts: dict[str, Any]) -> Event:
    data = {"alarm": entry.subject, "because": facts["because"]}
    text = f"{entry.actor} closed the alarm {entry.subject[:SHORT]}: {facts['because']}"
    return _alarm(entry, "trueup.alarm.closed", data, text)


def _alarm(entry: AuditEntry, type_: str, data: dict[str, Json], text: str) -> Event:
    return Event(EventName.ALARM, type_, entry, data, text, f"/plants/{entry.plant}")


def _diagnosis(entry: AuditEntry, facts: dict[str, Any]) -> Event | None:
    if facts["kind"] != "diagnose":
        return None
    from trueup.diagnose.summary_text import sentence  # noqa: PLC0415  (numpy)

    result = facts["result"]
    report, problem = result.get("report"), result.get("problem")
    answer = None if report is None else sentence(report)
    data = {
        "job": entry.subject,
        "state": facts["state"],
        "verdict": None if report is None else report["verdict"],
        "answer": answer,
        "candidate": result.get("artifact"),
        "problem": problem,
    }
    because = "" if problem is None else f": {problem['detail']}"
    text = f"the diagnosis {entry.subject[:SHORT]} " + (
        f"{facts['state']}{because}" if answer is None else f"says: {answer}"
    )
    page = f"/plants/{entry.plant}/diagnoses/{entry.subject}"
    return Event(EventName.DIAGNOSIS, "trueup.diagnosis.finished", entry, data, text, page)


def _decision(entry: AuditEntry, facts: dict[str, Any]) -> Event:
    decision = facts["decision"]
    failed = [v["rule"] for v in decision["verdicts"] if not v["passed"]]
    data = {
        "decision": entry.subject,
        **{k: decision[k] for k in ("accepted", "candidate", "incumbent", "gate", "verdicts")},
    }
    candidate = decision["candidate"][:SHORT]
    text = (
        f"the gate accepted the candidate {candidate}"
        if decision["accepted"]
        else f"the gate rejected the candidate {candidate}, which did not pass {', '.join(failed)}"
    )
    page = f"/plants/{entry.plant}/decisions/{entry.subject}"
    return Event(EventName.DECISION, "trueup.decision.made", entry, data, text, page)


def _move(entry: AuditEntry, facts: dict[str, Any]) -> Event:
    data = {
        "artifact": entry.subject,
        **{name: facts[name] for name in ("from", "generation", "decision")},
    }
    artifact, page = entry.subject[:SHORT], f"/plants/{entry.plant}"
    if facts["move"] == "promoted":
        text = (
            f"{entry.actor} promoted {artifact}, which serves at generation {facts['generation']}"
        )
        return Event(EventName.PROMOTION, "trueup.model.promoted", entry, data, text, page)
    text = f"{entry.actor} rolled back to {artifact}, which serves at generation " + str(
        facts["generation"]
    )
    return Event(EventName.ROLLBACK, "trueup.model.rolled_back", entry, data, text, page)


def _test(entry: AuditEntry, facts: dict[str, Any]) -> Event:
    text = f"{entry.actor} tests the webhook {entry.subject}"
    return Event(
        EventName.TEST, "trueup.webhook.tested", entry, {"webhook": entry.subject}, text, "/"
    )


_MAKERS: Mapping[str, Callable[[AuditEntry, dict[str, Any]], Event | None]] = {
    "episode:ingested": _episode,
    "alarm:raised": _alarm_raised,
    "alarm:closed": _alarm_closed,
    "job:finished": _diagnosis,
    "decision:made": _decision,
    "pointer:moved": _move,
    TESTED: _test,
}
_KINDS: Mapping[EventName, tuple[str, ...]] = {
    EventName.EPISODE: ("episode:ingested",),
    EventName.ALARM: ("alarm:raised", "alarm:closed"),
    EventName.DIAGNOSIS: ("job:finished",),
    EventName.DECISION: ("decision:made",),
    EventName.PROMOTION: ("pointer:moved",),
    EventName.ROLLBACK: ("pointer:moved",),
    EventName.TEST: (TESTED,),
}


def kinds_of(names: Iterable[str]) -> set[str]:
    """The kinds of entries of the log among which the events of these names are."""
    return {kind for name in names for kind in _KINDS[EventName(name)]}
