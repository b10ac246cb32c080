"""Write docs/settings.md from the settings themselves."""

from pathlib import Path

from trueup_service.settings import Settings

HEAD = """# Settings

Server and worker read them from the environment. The defaults are embedded storage: SQLite and a
folder, one server with a worker beside it.

| setting | default | meaning |
|---|---|---|
"""


def page() -> str:
    """The page's text."""
    rows = (
        f"| `TRUEUP_{name.upper()}` | {_shown(s.default)} | {s.description} |"
        for name, s in Settings.model_fields.items()
    )
    return HEAD + "\n".join(rows) + "\n"


def _shown(default: object) -> str:
    return "unset" if default is None else f"`{default}`"


if __name__ == "__main__":
    (Path(__file__).parent / "settings.md").write_text(page())
