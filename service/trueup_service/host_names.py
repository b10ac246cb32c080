"""Names of hosts as settings list them."""

from __future__ import annotations

import ipaddress

BELOW = "*."  # begins a pattern that stands for every name below another


def listed(setting: str | None) -> frozenset[str]:
    """The comma-separated names of a setting, in lower case."""
    names = (name.strip().lower() for name in (setting or "").split(","))
    return frozenset(name for name in names if name)


def is_listed(name: str, names: frozenset[str]) -> bool:
    """Whether a name in lower case is one of these, or below one of them that begins with `*.`."""
    return name in names or any(
        pattern.startswith(BELOW) and name.endswith(pattern[1:]) for pattern in names
    )


def is_address(name: str) -> bool:
    """Whether a host is named by its address."""
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
