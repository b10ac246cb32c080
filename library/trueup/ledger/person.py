"""Who is behind an entry of the log. A person may hold several tokens, so people are told apart by
the names of their tokens."""

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
    """A name as it is compared: without differences of case, width, spaces and invisible
    characters."""
    return seen(unicodedata.normalize("NFKC", name)).casefold()
