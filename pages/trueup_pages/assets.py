"""The files that pages need: ours, and vendored ones that are pinned by their digests.

Vendored: uPlot 1.6.32 (MIT) draws lines that can be zoomed; htmx 4.0.1 (0BSD) exchanges parts of a
page.
"""

from __future__ import annotations

import hashlib
from functools import cache
from importlib.resources import files

from trueup.errors import TrueupError

VENDORED = {
    "uplot.js": "19c8d4c6ad88929a79f4ae49d6f7161566dfd0ba3d15cc495e974f787eb78f1f",
    "uplot.css": "df630c6a8d6f8eeaff264b50f73ce5b114f646ffd9a0bb74f049b0a00135fa04",
    "htmx.js": "a0abb04f2f45a1f89d1d4844023245537e5e6014c87b144553e0607b4cc32130",
}
NOTICES = {"uplot.js": "uPlot 1.6.32, (c) Leon Sorokin, under the MIT licence"}
OURS = ("trueup.css", "trueup.js", "forms.js", "live.js")
TYPES = {"js": "text/javascript; charset=utf-8", "css": "text/css; charset=utf-8"}


class AssetChanged(TrueupError):
    """A vendored file is not the one that was reviewed."""

    code = "asset-changed"
    hint = "Install trueup again; if the file was replaced on purpose, pin its new digest."


@cache
def bytes_of(name: str) -> bytes:
    """Returns an asset's bytes. Raises KeyError for an unknown name, AssetChanged."""
    if name not in VENDORED and name not in OURS:
        raise KeyError(name)
    content = (files("trueup_pages") / "static" / name).read_bytes()
    if name in VENDORED and hashlib.sha256(content).hexdigest() != VENDORED[name]:
        raise AssetChanged(f"{name} is not the file that was reviewed", name=name)
    return content


def text_of(name: str) -> str:
    """Returns an asset as text to embed in a page that names no other host.

    A vendored one begins with its notice.
    """
    text = bytes_of(name).decode()
    if name in NOTICES:
        text = f"/* {NOTICES[name]} */\n{text.partition('*/')[2]}"
    return text.replace("</", "<\\/") if name.endswith(".js") else text


@cache
def url_of(name: str) -> str:
    """Returns an asset's URL. It holds the digest, so that a browser may cache it for ever."""
    stem, _, kind = name.rpartition(".")
    return f"/static/{stem}.{hashlib.sha256(bytes_of(name)).hexdigest()[:16]}.{kind}"


@cache
def by_url() -> dict[str, str]:
    """Returns every asset's name by the last part of its URL."""
    return {url_of(name).rpartition("/")[2]: name for name in (*VENDORED, *OURS)}


def type_of(name: str) -> str:
    """Returns an asset's media type."""
    return TYPES[name.rpartition(".")[2]]
