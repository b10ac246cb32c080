"""What the site needs beside the pages: links that leave the documentation are told as paths of the
repository."""

import re
from pathlib import Path
from typing import Any

LINK = re.compile(r"\[([^\]]*)\]\(([^)#\s]+)\)")
ROOT = Path(__file__).parent


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """A link to a file of the repository that is no page of the documentation becomes its name."""
    here = (ROOT / page.file.src_uri).parent

    def told(found: re.Match[str]) -> str:
        words, target = found.groups()
        to = (here / target).resolve()
        outside = (
            "://" not in target and not (to.is_relative_to(ROOT) and to.is_file()) and to.exists()
        )
        return f"{words} (`{to.relative_to(ROOT.parent)}`)" if outside else found.group(0)

    return LINK.sub(told, markdown)
