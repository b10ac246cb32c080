"""Who is behind an entry: people are counted by the name of their token, for one may hold
several."""

from __future__ import annotations

import unicodedata

from trueup.text import seen

ON_BEHALF = " for "  # between a token's name and whom its holder says to act for: "fleet for Ana"


def actor_of(name: str, on_behalf_of: str | None) -> str:
    """The actor of an entry: the name of the token, and whom its holder says to act for."""
    return f"{name}{ON_BEHALF}{on_behalf_of}" if on_behalf_of and on_behalf_of != name else name


def name_of(actor: str) -> str:
    """The name of the token in an actor."""
    return actor.partition(ON_BEHALF)[0]


def folded(name: str) -> str:
    """A name as it is compared: case, width, spaces and characters that show nothing make no other
    person."""
    return seen(unicodedata.normalize("NFKC", name)).casefold()
