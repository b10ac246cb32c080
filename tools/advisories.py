"""Look the pinned packages up among published advisories.

    python tools/advisories.py [--tell]

Exits with 1 if an advisory is known for a package, and with 3 if no package could be looked up.
With --tell it always exits with 0, for tests, whose result for a commit must not depend on the day.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

PINNED = ("requirements.txt", "requirements-dev.txt")
LIMIT_S = 120.0
NONE, KNOWN, AWAY = 0, 1, 3
OPTIONS = (
    "--disable-pip",
    "--no-deps",
    "--progress-spinner",
    "off",
    "--format",
    "json",
    "--timeout",
    "5",
)


def look_up(root: Path) -> list[dict[str, Any]]:
    """Returns what is known of each pinned package; nothing if the source does not answer."""
    files = [word for name in PINNED for word in ("--requirement", str(root / name))]
    command = [sys.executable, "-m", "pip_audit", *OPTIONS, *files]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=LIMIT_S)
        packages: list[dict[str, Any]] = json.loads(done.stdout)["dependencies"]
    except (subprocess.TimeoutExpired, ValueError, KeyError):
        return []
    return packages


def summary(packages: Sequence[Mapping[str, Any]]) -> tuple[list[str], int]:
    """Returns what is known in words, and the exit code."""
    known = [p for p in packages if "skip_reason" not in p]
    if not known:
        return [
            (
                "advisories: not one pinned package could be looked up, their source does "
                "not answer here"
            )
        ], AWAY
    lines = [f"advisories: {len(known)} of {len(packages)} pinned packages looked up"]
    for package in known:
        for advisory in package["vulns"]:
            fixed = ", ".join(advisory["fix_versions"]) or "no version yet"
            lines.append(
                f"  {package['name']} {package['version']}: {advisory['id']}, mended in {fixed}"
            )
    if len(lines) == 1:
        return [f"{lines[0]}, none is known"], NONE
    return lines, KNOWN


def main(arguments: Sequence[str]) -> int:
    """Looks the packages up, prints the summary, and returns the exit code."""
    lines, code = summary(look_up(Path(__file__).parent.parent))
    print(*lines, sep="\n")
    return 0 if "--tell" in arguments else code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
