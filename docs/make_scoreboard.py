"""Write the tables that `bench.machines` measured into scoreboard.md."""

from make_figures import HERE, filled

PAGE = HERE / "scoreboard.md"


def page() -> str:
    """The page with each table as it was measured last."""
    return filled(PAGE)


if __name__ == "__main__":
    PAGE.write_text(page())
