"""What the log says of a promotion after a rejection: whose approval counts, entry by entry."""

import pytest

from trueup.ledger.audit import AuditEntry
from trueup.ledger.gate_lines import GateLines

PLANT, GATE, CANDIDATE = "arm", "a" * 64, "b" * 64
REJECTED, ACCEPTED = "c" * 64, "d" * 64


class Log:
    """Entries in order, each looked at as it comes; the promotion of a candidate that was rejected on the same episode is the last."""

    def __init__(self) -> None:
        self.lines, self.size = GateLines(), 0
        self.add("plant:registered", PLANT, {"project": None})
        self.add("episode:ingested", "e" * 64, {})
        rules = {"rules": [], "scoring": {"horizon_s": 0.5, "windows": "every"}}
        self.add("gate:declared", GATE, {"gate": rules})
        for digest, passed in ((REJECTED, False), (ACCEPTED, True)):
            document = {
                "gate": GATE, "candidate": CANDIDATE, "accepted": passed, "episodes": ["e" * 64],
                "verdicts": [{"rule": "rollout_improves", "passed": passed}],
                "figures": {"candidate": {"rollout": [1.0], "one_step": [1.0]}},
                "known": {"candidate": [], "episodes": [], "compared": []}, "uses": [1],
            }  # fmt: skip
            self.add("decision:made", digest, {"decision": document, "job": "none"})

    def add(self, kind, subject, facts, actor="ana", plant=PLANT):
        self.size += 1
        return self.lines(AuditEntry(self.size, "2026-01-01T00:00:00Z", kind, actor, plant, subject, facts, {}))

    def token(self, prefix, name):
        self.add("token:issued", prefix, {"name": name}, "admin", None)

    def approve(self, actor, token):
        self.add("decision:approved", ACCEPTED, {"because": "seen on the bench", "token": token}, actor)

    def promote(self, actor, **token):
        return self.add("pointer:moved", CANDIDATE, {"move": "promoted", "decision": ACCEPTED, **token}, actor)


@pytest.fixture
def log():
    made = Log()
    made.token("1", "ana")
    made.token("2", "Ana ")
    made.token("3", "ben")
    return made


def test_somebody_elses_approval_counts_and_is_told(log):
    log.approve("ben", "3")
    assert log.promote("ana", token="1") == []
    assert log.lines.notes[-1].endswith("with the approval of ben and a reason")


def test_ones_own_second_token_does_not_count(log):
    log.approve("Ana ", "2")
    assert "with nobody else's approval" in log.promote("ana", token="1")[0].what


def test_acting_for_somebody_else_makes_no_second_person(log):
    log.approve("ana for Ben", "1")
    assert log.promote("ana for Cleo", token="1")


def test_the_approval_of_a_revoked_token_does_not_count(log):
    log.approve("ben", "3")
    log.add("token:revoked", "3", {"name": "ben"}, "admin", None)
    assert log.promote("ana", token="1")


def test_a_promotion_that_names_no_token_is_held_by_the_name_of_its_actor(log):
    log.approve("Ana  for Ben", "2")
    assert log.promote("ana")
