"""Write the tables that benches measured into figures.md, each between `<!-- table NAME -->` and
`<!-- /table -->`."""

import json
import re
from pathlib import Path

HERE = Path(__file__).parent
PAGE = HERE / "figures.md"
PLACE = re.compile(r"(<!-- table (\w+) -->\n).*?(<!-- /table -->)", re.DOTALL)


def page() -> str:
    """The page with each table as it was measured last."""
    return filled(PAGE)


def filled(page: Path) -> str:
    """A page with each of its tables as it was measured last."""
    return PLACE.sub(lambda found: f"{found[1]}{_table(found[2])}{found[3]}", page.read_text())


def _table(name: str) -> str:
    measured = json.loads((HERE / "measured" / f"{name}.json").read_text())
    rows = [measured["head"], ["---"] * len(measured["head"]), *measured["rows"]]
    return "\n" + "".join(f"| {' | '.join(row)} |\n" for row in rows) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page())
