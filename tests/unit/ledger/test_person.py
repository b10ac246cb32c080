"""Whom a name names."""

import pytest

from trueup.ledger.person import actor_of, folded, name_of


@pytest.mark.parametrize(
    "written", ["Ana", "ana ", "AN\u200bA", "\uff21na", "\u2060ana\u00ad", "ana\u3164"]
)
def test_what_looks_the_same_is_the_same_person(written):
    assert folded(written) == "ana"


@pytest.mark.parametrize("other", ["anna", "an a", "anä", "आना"])
def test_what_looks_otherwise_is_another(other):
    assert folded(other) != "ana"
    assert folded(other)


def test_whom_a_token_acts_for_is_said_behind_its_name_and_makes_nobody_else():
    assert actor_of("fleet", "Ana") == "fleet for Ana"
    assert actor_of("fleet", "fleet") == actor_of("fleet", None) == "fleet"
    assert name_of("fleet for Ana") == "fleet"
