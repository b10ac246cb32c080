"""Templates with values become HTML.

A value that is not marked as markup is escaped, and a missing value is an error.
"""

from __future__ import annotations

from datetime import UTC, datetime
from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from trueup.diagnose import number_text, summary_text
from trueup.gate import verdict_text
from trueup_pages import copy_as, drawing
from trueup_pages.assets import text_of, url_of
from trueup_pages.timeline import page_of, timeline, zooms

CLOCK_SET_NS = 631_152_000 * 10**9  # 1990: an earlier time is that of a clock which was never set


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("trueup_pages"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(
        short=number_text.short,
        unit=number_text.unit,
        named=summary_text.name,
        percent=number_text.percent,
        moment=moment,
        recorded=recorded,
        plain=lambda text: text.replace("_", " "),
    )
    environment.globals.update(
        asset=url_of,
        inlined=lambda name: Markup(text_of(name)),
        drawing=drawing,
        words=summary_text,
        verdict_text=verdict_text,
        timeline=timeline,
        zooms=zooms,
        page_of=page_of,
        command=copy_as.command,
        rest=copy_as.rest,
        rest_of_file=copy_as.rest_of_file,
    )
    return environment


def render(template: str, **values: Any) -> str:
    """Renders a page, or a part of one. Raises TypeError for a value that would hide what every
    template knows by that name."""
    hidden = values.keys() & _environment().globals.keys()
    if hidden:
        raise TypeError(f"every template knows {', '.join(sorted(hidden))}: choose another name")
    return _environment().get_template(template).render(**values)


def recorded(at_ns: int) -> Markup:
    """Returns when a recording began [ns since 1970], in UTC; a dash where its clock was never
    set."""
    if at_ns < CLOCK_SET_NS:
        return Markup("–")
    return moment(datetime.fromtimestamp(at_ns / 1e9, UTC).isoformat())


def moment(at: str) -> Markup:
    """Returns a time in UTC, shown to the second."""
    return Markup('<time datetime="{0}">{1}</time>').format(at, at[:19].replace("T", " "))
