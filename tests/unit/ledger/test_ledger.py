"""Pointer and audit log as pure values, with properties."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trueup.errors import BrokenChain, PointerMoved
from trueup.ledger.audit import AuditEntry, rebuild
from trueup.ledger.pointer import (
    JudgedDecision,
    NotAccepted,
    NothingToRollBackTo,
    ServingPointer,
    promote,
    roll_back,
)
from trueup.ledger.rows import KEYS, row_digest
from trueup_service.registry.tables import metadata

NOW = "2026-01-01T00:00:00.000000Z"
POINTER = ServingPointer("p", 4, "incumbent", "d0", NOW)
DECISION = JudgedDecision(
    "d1", accepted=True, candidate="candidate", incumbent="incumbent", generation=4
)


def test_an_accepted_decision_moves_the_pointer_by_one():
    assert promote(POINTER, DECISION, 4, "later") == ServingPointer(
        "p", 5, "candidate", "d1", "later"
    )


def test_a_decision_cannot_be_replayed_after_a_rollback():
    moved = promote(POINTER, DECISION, 4, NOW)
    back = roll_back(moved, "incumbent", 5, NOW)
    assert (back.artifact, back.generation) == ("incumbent", 6)
    with pytest.raises(PointerMoved):
        promote(back, DECISION, 6, NOW)


def test_a_rejected_decision_never_moves_the_pointer():
    with pytest.raises(NotAccepted):
        promote(POINTER, replace(DECISION, accepted=False), 4, NOW)


@pytest.mark.parametrize("expected", [3, 5])
def test_a_move_from_another_generation_is_refused(expected):
    with pytest.raises(PointerMoved):
        promote(POINTER, DECISION, expected, NOW)
    with pytest.raises(PointerMoved):
        roll_back(POINTER, "before", expected, NOW)


def test_a_decision_against_another_incumbent_is_refused():
    with pytest.raises(PointerMoved):
        promote(POINTER, replace(DECISION, incumbent="other"), 4, NOW)


def test_there_must_be_something_to_roll_back_to():
    with pytest.raises(NothingToRollBackTo):
        roll_back(POINTER, None, 4, NOW)


def log(facts):
    return [
        AuditEntry(i + 1, NOW, "thing:done", "a", None, str(i), {"fact": fact}, {})
        for i, fact in enumerate(facts)
    ]


FACTS = st.lists(
    st.one_of(
        st.text(),
        st.integers(-(2**53) + 1, 2**53 - 1),
        st.floats(allow_nan=False, allow_infinity=False),
        st.none(),
    ),
    min_size=1,
    max_size=8,
)


@given(FACTS, st.data())
def test_an_edit_a_removal_and_a_swap_change_the_root_or_break_the_order(facts, data):
    entries = log(facts)
    root = rebuild(entries).root()
    at = data.draw(st.integers(0, len(entries) - 1))
    for edit in (
        {"actor": "b"},
        {"facts": {"fact": "other"}},
        {"rows": {"plants/p": "0"}},
        {"at": "2020"},
        {"plant": "p"},
    ):
        assert (
            rebuild([*entries[:at], replace(entries[at], **edit), *entries[at + 1 :]]).root()
            != root
        )
    if at < len(entries) - 1:
        with pytest.raises(BrokenChain):
            rebuild([*entries[:at], *entries[at + 1 :]])
        with pytest.raises(BrokenChain):
            rebuild([*entries[:at], entries[at + 1], entries[at], *entries[at + 2 :]])


def test_a_row_named_like_another_is_not_it():
    assert row_digest("gates", {"a": 1}) != row_digest("plants", {"a": 1})


def test_the_rows_that_the_log_names_are_the_tables_of_the_registry_by_their_keys():
    for table, key in KEYS.items():
        assert tuple(metadata.tables[table].primary_key.columns.keys()) == key
    unnamed = set(metadata.tables) - set(KEYS)
    assert unnamed == {
        "audit",
        "audit_tree",
        "audit_head",
        "audit_key",
        "job_reads",
        "attempts",
        "idempotency",
        "sessions",
        "webhook_cursors",
    }
