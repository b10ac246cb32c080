"""What the site needs beside the pages: links that leave the documentation are told as paths of the
repository, and equations are MathML, which browsers draw without a script."""

import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert

BLOCK = re.compile(r"^```math\n(.*?)^```$", re.MULTILINE | re.DOTALL)
CODE = re.compile(r"(^```.*?^```$|`[^`\n]*`)", re.MULTILINE | re.DOTALL)
INLINE = re.compile(r"\$([^$\s`][^$\n`]*?)\$(?![0-9A-Za-z])")
LINK = re.compile(r"\[([^\]]*)\]\(([^)#\s]+)\)")
ROOT = Path(__file__).parent


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """A link to a file of the repository that is no page of the documentation becomes its name, and
    LaTeX becomes MathML."""
    here = (ROOT / page.file.src_uri).parent

    def told(found: re.Match[str]) -> str:
        words, target = found.groups()
        to = (here / target).resolve()
        outside = (
            "://" not in target and not (to.is_relative_to(ROOT) and to.is_file()) and to.exists()
        )
        return f"{words} (`{to.relative_to(ROOT.parent)}`)" if outside else found.group(0)

    return equations(LINK.sub(told, markdown))


def equations(markdown: str) -> str:
    """Equations in blocks, and within lines that are no code, as MathML."""
    parts = CODE.split(BLOCK.sub(lambda m: _mathml(m[1], "block"), markdown))
    parts[::2] = [INLINE.sub(lambda m: _mathml(m[1], "inline"), part) for part in parts[::2]]
    return "".join(parts)


def _mathml(latex: str, display: str) -> str:
    drawn = convert(" ".join(latex.split()), display=display)
    return f'<div style="overflow-x: auto">{drawn}</div>' if display == "block" else drawn
