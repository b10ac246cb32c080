"""`trueup effects`: list the effects that a search tries, and check one of your own by the laws."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from trueup.errors import TrueupError
from trueup_cli.exits import REFUSED
from trueup_cli.options import Json
from trueup_cli.show import as_json, progress, say, table


def effects(
    *files: Path,
    laws: Annotated[
        bool,
        Parameter(
            negative=(),
            help="Check those that are not of the catalogue by the laws that all effects obey",
        ),
    ] = False,
    as_json_: Json = False,
) -> None:
    """List every effect that a search tries: of the catalogue, of installed packages, of files.

    Parameters
    ----------
    files
        Python files that define an effect each; TRUEUP_EFFECTS names files for every command
    """
    from trueup.model.effect import effects as known
    from trueup.model.effect import load_effect, source_of

    for file in files:
        load_effect(file)
    rows = [
        (e.name, str(e.port.reported), e.category, (source_of(e.name) or "the catalogue")[:16])
        for e in known().values()
    ]
    broken = _broken([name for name, *_ in rows if source_of(name)]) if laws else {}
    if as_json_:
        as_json(
            [
                {
                    "effect": name,
                    "port": port,
                    "category": category,
                    "source": source_of(name),
                    **({"laws": broken.get(name, [])} if laws and source_of(name) else {}),
                }
                for name, port, category, _ in rows
            ]
        )
    else:
        table("Effects", ["effect", "port", "category", "from"], rows)
        for name, why in ((n, w) for n, all_of in broken.items() for w in all_of):
            say("[red]{}[/]: {}", name, why)
        if laws and not any(broken.values()):
            say("{} obey every law", ", ".join(broken) or "no effect from outside: none to check")
    if any(broken.values()):
        raise SystemExit(REFUSED)


def _broken(names: list[str]) -> dict[str, list[str]]:
    """Returns of each effect the laws that it breaks, in words."""
    from trueup.checks.effect_laws import LAWS
    from trueup.model.effect import effects as known

    broken: dict[str, list[str]] = {}
    with progress("laws") as bar:
        for i, name in enumerate(names):
            broken[name] = []
            for j, law in enumerate(LAWS):
                bar((i + j / len(LAWS)) / len(names), f"{name}: {law.__name__.replace('_', ' ')}")
                try:
                    law(known()[name])
                except TrueupError as error:
                    broken[name].append(error.message)
    return broken
