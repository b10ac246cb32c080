"""What the log says of a promotion after a rejection: whose approval counts, entry by entry."""

import pytest

from trueup.ledger.audit import AuditEntry
from trueup.ledger.gate_lines import GateLineCheck

PLANT, GATE, CANDIDATE = "arm", "a" * 64, "b" * 64
REJECTED, ACCEPTED = "c" * 64, "d" * 64


class Log:
    """Entries in order, each looked at as it comes; the promotion of a candidate that was rejected
    on the same episode is the last."""

    def __init__(self) -> None:
        self.lines, self.size = GateLineCheck(), 0
        self.add("plant:registered", PLANT, {"project": None})
        self.add("episode:ingested", "e" * 64, {"role": "validation"})
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
        return self.lines(
            AuditEntry(self.size, "2026-01-01T00:00:00Z", kind, actor, plant, subject, facts, {})
        )

    def token(self, prefix, name):
        self.add("token:issued", prefix, {"name": name}, "admin", None)

    def approve(self, actor, token):
        self.add(
            "decision:approved", ACCEPTED, {"because": "seen on the bench", "token": token}, actor
        )

    def promote(self, actor, **token):
        return self.add(
            "pointer:moved", CANDIDATE, {"move": "promoted", "decision": ACCEPTED, **token}, actor
        )


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
    assert log.lines.remarks[-1].endswith("with the approval of ben and a reason")


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


OTHER = "f" * 64


def judged(log, candidate, *, beside=(), **claimed):
    """A trial of a candidate on the log's only episode, asked for and decided; what is found in its
    decision."""
    figures = {"rollout": [1.0], "one_step": [1.0]}
    log.add(
        "job:submitted",
        "job",
        {"kind": "gate", "request": {"gate": GATE, "candidate": candidate, "episodes": ["e" * 64]}},
    )
    document = {
        "gate": GATE, "candidate": candidate, "accepted": True, "episodes": ["e" * 64],
        "verdicts": [{"rule": "rollout_improves", "passed": True}],
        "known": {"candidate": [], "episodes": [], "compared": []}, "uses": [1],
        "figures": {"candidate": figures, "beside": dict.fromkeys(beside, figures)},
        "selection": {"held_out": 1, "accepted": 1, "rejected": 1, "comparisons": 0, **claimed},
    }  # fmt: skip
    return [
        f.what for f in log.add("decision:made", "9" * 64, {"decision": document, "job": "job"})
    ]


def test_a_decision_that_tells_all_is_as_the_log_says(log):
    assert judged(log, OTHER, beside=[CANDIDATE]) == []
    assert "Its errors are within 1 % of those of candidate bbbb" in log.lines.remarks[-1]


@pytest.mark.parametrize(
    "claimed", [{"held_out": 2}, {"rejected": 0}, {"accepted": 0}, {"comparisons": 1}]
)
def test_a_decision_that_tells_another_selection_is_found(log, claimed):
    assert (
        "the selection that decision 999999999999 tells is not what the log tells"
        in judged(log, OTHER, beside=[CANDIDATE], **claimed)[0]
    )


@pytest.mark.parametrize("beside", [(), (CANDIDATE, "0" * 64)])
def test_a_decision_that_hides_who_was_rejected_before_or_makes_somebody_up_is_found(log, beside):
    (findings,) = judged(log, OTHER, beside=beside)
    assert findings == (
        "the candidates scored beside that of decision 999999999999 are not those that "
        "the log calls for"
    )


def test_what_errs_as_a_rejected_candidate_does_is_held_to_its_rejection(log):
    judged(log, OTHER, beside=[CANDIDATE])
    findings = log.add(
        "pointer:moved", OTHER, {"move": "promoted", "decision": "9" * 64, "token": "1"}
    )
    assert "with nobody else's approval" in findings[0].what
