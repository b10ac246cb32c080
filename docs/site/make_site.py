"""Build the documentation as a site: `make_site.py [FOLDER]`, by default build/site.

The pages are copied first, and two things in them are changed. A link that leaves the documentation
becomes the path of the file in the repository; and equations become MathML, which browsers draw
without a script. The site loads nothing from another host, and its search works from a folder, too.
"""

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from latex2mathml.converter import convert

SITE = Path(__file__).parent
DOCS = SITE.parent
ROOT = DOCS.parent
COPIED = ("*.md", "adr", "measured", "pictures")
BLOCK = re.compile(r"^```math\n(.*?)^```$", re.MULTILINE | re.DOTALL)
CODE = re.compile(r"(^```.*?^```$|`[^`\n]*`)", re.MULTILINE | re.DOTALL)
INLINE = re.compile(r"\$([^$\s`][^$\n`]*?)\$(?![0-9A-Za-z])")
LINK = re.compile(r"\[([^\]]*)\]\(([^)#\s]+)\)")
WORKER = "folder_worker.js"
# The generator's own means of searching from a folder, which it loads from another host.
ELSEWHERE = re.compile(r'(?<=<script src=")https?://[^"]*(?=")')


def build(folder: Path) -> None:
    """Build the site into a folder. Raises CalledProcessError for a link that leads nowhere."""
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        pages = work / "docs"
        pages.mkdir()
        for pattern in COPIED:
            for source in DOCS.glob(pattern):
                (shutil.copytree if source.is_dir() else shutil.copy)(source, pages / source.name)
        for page in pages.rglob("*.md"):
            here = (DOCS / page.relative_to(pages)).parent
            page.write_text(equations(links(page.read_text(), here)))
        shutil.copy(SITE / WORKER, pages)
        shutil.copy(SITE / "zensical.toml", work)
        zensical = Path(sys.executable).parent / "zensical"
        subprocess.run(
            [zensical, "build", "--strict"], cwd=work, check=True, stdout=subprocess.DEVNULL
        )
        made = work / "site"
        for html in made.rglob("*.html"):
            up = "../" * (len(html.relative_to(made).parts) - 1)
            html.write_text(ELSEWHERE.sub(up + WORKER, html.read_text()))
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(made, folder)


def links(markdown: str, here: Path) -> str:
    """Markdown of a page in the folder `here`, whose links to files of the repository that are no
    pages of the documentation are those files' paths."""

    def written(link: re.Match[str]) -> str:
        words, target = link.groups()
        to = (here / target).resolve()
        inside = "://" in target or (to.is_relative_to(DOCS) and to.is_file()) or not to.exists()
        return link.group(0) if inside else f"{words} (`{to.relative_to(ROOT)}`)"

    return LINK.sub(written, markdown)


def equations(markdown: str) -> str:
    """Markdown whose equations, in blocks and within lines that are no code, are MathML."""
    parts = CODE.split(BLOCK.sub(lambda m: _mathml(m[1], "block"), markdown))
    parts[::2] = [INLINE.sub(lambda m: _mathml(m[1], "inline"), part) for part in parts[::2]]
    return "".join(parts)


def _mathml(latex: str, display: str) -> str:
    drawn = convert(" ".join(latex.split()), display=display)
    return f'<div style="overflow-x: auto">{drawn}</div>' if display == "block" else drawn


if __name__ == "__main__":
    build(Path(sys.argv[1]) if sys.argv[1:] else ROOT / "build" / "site")
