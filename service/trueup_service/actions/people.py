"""The person behind a token. Tokens of one name belong to one person, and a revoked token to
nobody."""

from __future__ import annotations

from trueup.ledger.person import folded, name_of
from trueup_service.registry.transaction import ReadTransaction


def person_of(tx: ReadTransaction, token: str, actor: str) -> str | None:
    """The folded name of the person behind a token's prefix, None where the token was revoked.

    An unknown token, such as the admin's token of the settings or one of the site that a plant was
    imported from, belongs to its actor.
    """
    record = tx.tokens.get(token)
    if record is None:
        return folded(name_of(actor))
    return None if record.revoked_at is not None else folded(record.name)
