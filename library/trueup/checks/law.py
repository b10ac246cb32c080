"""A law is a function that takes a subject and raises LawBroken, named for what must hold."""

from __future__ import annotations

from trueup.errors import TrueupError


class LawBroken(TrueupError):
    """A subject breaks a law."""

    code = "law-broken"
    hint = "Mend the subject; no subject is exempt from a law."


def require(holds: bool, law: str, subject: str, why: str = "") -> None:
    """Raises LawBroken unless it holds."""
    if not holds:
        raise LawBroken(
            f"{subject} breaks the law: {law}. {why}".rstrip(". ") + ".", law=law, subject=subject
        )
