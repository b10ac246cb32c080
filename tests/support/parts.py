"""The folders of the distributions, each of which is installed alone."""

from pathlib import Path

ROOT = Path(__file__).parent.parent.parent
PARTS = ("library", "client", "pages", "migrations", "service", "worker", "cli")
