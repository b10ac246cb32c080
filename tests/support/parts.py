"""The folders that are installed alone, each a distribution."""

from pathlib import Path

ROOT = Path(__file__).parent.parent.parent
PARTS = ("library", "client", "pages", "migrations", "service", "worker", "cli")
