"""The pages that list a plant's episodes, versions and decisions. How a list is sorted and filtered
stands in its address, which is therefore a link to it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any
from urllib.parse import urlencode

from fastapi import Query, Request, Response

from trueup.episode.role import Role
from trueup_service.actions import find
from trueup_service.actions.label import tag_as_kept
from trueup_service.http.dependencies import PlantName, RequestParts
from trueup_service.http.pages.page import go, page_router, show
from trueup_service.registry.label_record import Labelled
from trueup_service.registry.listing import LINES, LISTED, NAME, Wanted, lines
from trueup_service.registry.transaction import ReadTransaction, reading
from trueup_service.wiring import Parts

router = page_router()
MOST_PAGES = 100_000
Text = Annotated[str, Query(max_length=200)]
PageNumber = Annotated[int, Query(ge=1, le=MOST_PAGES)]


@dataclass(frozen=True, slots=True)
class List:
    """A list: its page, what it is sorted by at first, what its parameter `only` is called, and the
    values that this may have, by how they are written."""

    template: str
    sort: str
    selected_by: str
    values: Mapping[str, Any]


EPISODES = List("episodes.html", "-uploaded", "role", {str(r): str(r) for r in Role})
VERSIONS = List(
    "versions.html",
    "-version",
    "kind",
    {k: k for k in ("nominal", "identified", "residual", "blind", "conditioned", "corrected")},
)
DECISIONS = List("decisions.html", "-decided", "verdict", {"accepted": True, "rejected": False})


@router.get("/plants/{plant}/episodes")
def episodes(
    request: Request,
    parts: RequestParts,
    plant: PlantName,
    sort: Text = EPISODES.sort,
    q: Text = "",
    tag: Text = "",
    role: Text = "",
    page: PageNumber = 1,
) -> Response:
    """A plant's episodes."""
    asked = {"sort": sort, "q": q, "tag": tag, "role": role, "page": page}
    return _shown(request, parts, plant, Labelled.EPISODE, EPISODES, asked)


@router.get("/plants/{plant}/versions")
def versions(
    request: Request,
    parts: RequestParts,
    plant: PlantName,
    sort: Text = VERSIONS.sort,
    q: Text = "",
    tag: Text = "",
    kind: Text = "",
    page: PageNumber = 1,
) -> Response:
    """A plant's versions, each with the newest decision on it."""
    asked = {"sort": sort, "q": q, "tag": tag, "kind": kind, "page": page}
    return _shown(request, parts, plant, Labelled.VERSION, VERSIONS, asked)


@router.get("/plants/{plant}/decisions")
def decisions(
    request: Request,
    parts: RequestParts,
    plant: PlantName,
    sort: Text = DECISIONS.sort,
    q: Text = "",
    tag: Text = "",
    verdict: Text = "",
    page: PageNumber = 1,
) -> Response:
    """A plant's decisions."""
    asked = {"sort": sort, "q": q, "tag": tag, "verdict": verdict, "page": page}
    return _shown(request, parts, plant, Labelled.DECISION, DECISIONS, asked)


def _shown(
    request: Request,
    parts: Parts,
    plant: str,
    kind: Labelled,
    of: List,
    asked: Mapping[str, Any],
) -> Response:
    sorts = [*LISTED[kind].sorts, NAME]
    sort = asked["sort"] if str(asked["sort"]).removeprefix("-") in sorts else of.sort
    only = of.values.get(str(asked[of.selected_by]))
    tag = tag_as_kept(str(asked["tag"]))
    wanted = Wanted(sort, str(asked["q"]).strip(), tag, only, int(asked["page"]))
    defaults = {"sort": of.sort, "q": "", "tag": "", of.selected_by: "", "page": 1}

    def link(**changes: object) -> str:
        """The address of the list with some of what is asked changed."""
        query = {k: v for k, v in {**asked, "page": 1, **changes}.items() if v != defaults[k]}
        return f"/plants/{plant}/{kind}s" + (f"?{urlencode(query)}" if query else "")

    with reading(parts.database) as tx:
        find.plant_digest(tx, plant)
        listed, count = lines(tx, plant, kind, wanted)
        pages = -(-count // LINES)
        if count and wanted.page > pages:  # some are gone from the list since the link was made
            return go(link(page=pages))
        values: dict[str, Any] = {
            "plant": plant,
            "lines": listed,
            "count": count,
            "pages": pages,
            "asked": {**asked, "sort": sort, "tag": tag},
            "filtered": bool(wanted.containing or wanted.tag or only is not None),
            "link": link,
            "sorts": sorts,
            "choices": list(of.values),
            "selected_by": of.selected_by,
            "tags": tx.labels.tags(plant, kind),
            "serving": find.serving(tx, plant),
            **_beside(tx, plant, kind, [line.record for line in listed]),
        }
    return show(request, of.template, **values)


def _beside(tx: ReadTransaction, plant: str, kind: Labelled, records: list[Any]) -> dict[str, Any]:
    """What a list shows of other things: of versions the newest decision on each, of decisions the
    numbers of the versions that they name."""
    if kind is Labelled.VERSION:
        return {"judged": tx.decisions.newest_on(plant, [r.digest for r in records])}
    if kind is Labelled.DECISION:
        named = {d for r in records for d in (r.candidate, r.incumbent)}
        return {"version_of": tx.artifacts.numbers(plant, sorted(named))}
    return {}
