"""Pointer and audit log as pure values, with properties."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trueup.errors import BrokenChain, PointerMoved
from trueup.ledger.audit import GENESIS, append, verify
from trueup.ledger.pointer import Judged, NotAccepted, NothingToRollBackTo, ServingPointer, promote, roll_back

NOW = "2026-01-01T00:00:00.000000Z"
POINTER = ServingPointer("p", 4, "incumbent", "d0", NOW)
DECISION = Judged("d1", accepted=True, candidate="candidate", incumbent="incumbent", generation=4)


def test_an_accepted_decision_moves_the_pointer_by_one():
    assert promote(POINTER, DECISION, 4, "later") == ServingPointer("p", 5, "candidate", "d1", "later")


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
    entries, last = [], (0, GENESIS)
    for i, fact in enumerate(facts):
        entries.append(append(last, at=NOW, kind="thing:done", actor="a", plant=None, subject=str(i), facts={"fact": fact}))
        last = entries[-1].sequence, entries[-1].digest
    return entries


FACTS = st.lists(
    st.one_of(st.text(), st.integers(-(2**53) + 1, 2**53 - 1), st.floats(allow_nan=False, allow_infinity=False), st.none()),
    min_size=1,
    max_size=8,
)


@given(FACTS)
def test_a_log_that_was_appended_to_verifies(facts):
    entries = log(facts)
    assert verify(entries) == (len(facts), entries[-1].digest)


@given(FACTS, st.data())
def test_an_edit_a_removal_and_a_swap_are_found(facts, data):
    entries = log(facts)
    at = data.draw(st.integers(0, len(entries) - 1))
    edited = [*entries[:at], replace(entries[at], actor="b"), *entries[at + 1 :]]
    with pytest.raises(BrokenChain):
        verify(edited)
    if at < len(entries) - 1:
        with pytest.raises(BrokenChain):
            verify([*entries[:at], *entries[at + 1 :]])
        with pytest.raises(BrokenChain):
            verify([*entries[:at], entries[at + 1], entries[at], *entries[at + 2 :]])


@given(FACTS)
def test_an_entry_replaced_with_a_matching_digest_still_breaks_the_chain_behind_it(facts):
    entries = log([*facts, "last"])
    forged = append((0, GENESIS), at=NOW, kind="thing:done", actor="forger", plant=None, subject="0", facts={"fact": facts[0]})
    with pytest.raises(BrokenChain) as found:
        verify([forged, *entries[1:]])
    assert found.value.facts["sequence"] == 2
