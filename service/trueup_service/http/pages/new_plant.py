"""The pages on which a plant is registered: files are dropped, what they propose is shown and
corrected, and then registered."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fastapi import Request, Response
from starlette.concurrency import run_in_threadpool

from trueup.episode.units import ANGLES, LENGTHS, RATES, SPEEDS
from trueup.errors import TrueupError
from trueup_service.drafts import Draft, Drafts
from trueup_service.http.dependencies import Digest, RequestContext, RequestParts
from trueup_service.http.drafting import register_draft, revise_draft
from trueup_service.http.guard import CurrentPrincipal
from trueup_service.http.pages.page import checked, form, go, page_router, show
from trueup_service.http.schemas.drafts import Wishes

router = page_router()
SYMBOLS = {"q": ("observations", "position"), "v": ("observations", "velocity")}
STAGES = {
    "physical": "the machine itself (physical)",
    "HIL": "hardware in the loop (HIL)",
    "PIL": "a processor in the loop (PIL)",
    "SIL": "software in the loop (SIL)",
    "MIL": "a simulation (MIL)",
}
FAMILIES = {
    "inertia": "a = −c v + b u",
    "pendulum": "a = −k sin q − c v + b u",
    "oscillator": "a = −k q − c v + b u",
}
REGISTER = "register"


@router.get("/new")
def new(request: Request) -> Response:
    """Where the files of a new plant are dropped."""
    return show(request, "new.html")


@router.get("/new/{draft}")
def review(
    request: Request, parts: RequestParts, principal: CurrentPrincipal, draft: Digest
) -> Response:
    """What the files propose."""
    return _page(request, Drafts(parts.settings.data_dir).get(principal.token, draft))


@router.post("/new/{draft}")
async def decide(
    request: Request,
    parts: RequestParts,
    context: RequestContext,
    principal: CurrentPrincipal,
    draft: Digest,
) -> Response:
    """Make the draft again where something was corrected, and register it where that was asked
    for."""
    fields = await form(request)
    there = Drafts(parts.settings.data_dir)
    now = await run_in_threadpool(there.get, principal.token, draft)
    try:
        wishes = _wishes(fields, now)
        if wishes != _normal(now.document["wishes"]):
            now = await revise_draft(request, parts, principal, draft, wishes)
        if fields.get("do") != REGISTER or now.document["plant"] is None:
            return go(f"/new/{draft}")
        gate = fields.get("gate") == "yes"
        made = await register_draft(request, parts, context, principal, draft, declares_gate=gate)
    except TrueupError as error:
        return await run_in_threadpool(_page, request, now, error)
    return go(f"/plants/{made.plant.record['name']}")


def _normal(wishes: Any) -> dict[str, Any]:
    """Wishes without what is as it is by default."""
    valid = Wishes.model_validate(wishes)
    return valid.model_dump(exclude_none=True, exclude_defaults=True)


def _wishes(fields: Mapping[str, str], before: Draft) -> dict[str, Any]:
    """What the form says, in the words of a draft. What it shows as it was found is left to be
    found again. Raises BadRequest."""
    shown = _chosen(before.document)
    wanted: dict[str, Any] = {
        "name": fields.get("name") or None,
        "stage": fields.get("stage") or "physical",
        "family": fields.get("family") or None,
        "signals": _changed(fields, "signal", shown["signals"]),
        "units": _changed(fields, "unit", shown["units"]),
        "time": fields.get("time") or None,
        "time_unit": fields.get("time-unit") or None,
    }
    earlier: Any = before.document["wishes"]
    for key in ("rate_hz", "joint", "plant", "mapping"):
        wanted[key] = earlier.get(key)
    if wanted["signals"] or wanted["units"]:
        wanted["mapping"] = None  # which was of other signals
    for key in ("signals", "units"):
        wanted[key] = {**earlier.get(key, {}), **wanted[key]}
        wanted[key] = {symbol: value for symbol, value in wanted[key].items() if value}
    for key in ("time", "time_unit"):
        if wanted[key] == shown[key]:
            wanted[key] = earlier.get(key)
    if wanted["family"] == shown["family"]:
        wanted["family"] = earlier.get("family")
    if wanted["name"] == before.document["name"]:
        wanted["name"] = earlier.get("name")
    return _normal(checked(Wishes.model_validate, wanted))


def _changed(fields: Mapping[str, str], what: str, shown: Mapping[str, str]) -> dict[str, str]:
    """Of q, v and u the fields that are not as they were shown."""
    given = {symbol: fields.get(f"{what}-{symbol}", shown[symbol]).strip() for symbol in shown}
    return {symbol: value for symbol, value in given.items() if value != shown[symbol]}


def _chosen(document: Mapping[str, Any]) -> dict[str, Any]:
    """Which signals, units and family a draft has now; empty where it has none."""
    mapping = document["mapping"] or {}
    wishes = document["wishes"]
    sources: dict[str, Any] = {
        symbol: next((s for s in mapping.get(part, []) if s["field"] == field), {})
        for symbol, (part, field) in SYMBOLS.items()
    }
    sources["u"] = next(iter(mapping.get("commands", [])), {})
    time = mapping.get("time", {})
    plant = document["plant"] or {}
    return {
        "signals": {
            symbol: source.get("signal", wishes.get("signals", {}).get(symbol, ""))
            for symbol, source in sources.items()
        },
        "units": {
            symbol: source.get("unit", wishes.get("units", {}).get(symbol, ""))
            for symbol, source in sources.items()
        },
        "time": time.get("signal", wishes.get("time")),
        "time_unit": time.get("unit", wishes.get("time_unit")),
        "family": plant.get("nominal", {}).get("family"),
    }


def _page(request: Request, draft: Draft, refused: TrueupError | None = None) -> Response:
    document: Any = draft.document
    plant, mapping = document["plant"], document["mapping"] or {}
    joints = {s.get("joint") for s in mapping.get("observations", [])}
    nominal = (plant or {}).get("nominal", {})
    one_joint = len(joints) <= 1 and "mjcf" not in nominal
    return show(
        request,
        "draft.html",
        d=document,
        chosen=_chosen(document),
        guesses=mapping.get("guesses", []),
        signals_shown=one_joint and bool(document["signals"]),
        is_table=bool(mapping.get("time")) or document["problem"] is not None,
        families=FAMILIES if one_joint and document["signals"] else {},
        stages=STAGES,
        units={"q": (*ANGLES, *LENGTHS), "v": (*RATES, *SPEEDS)},
        observed=len((plant or {}).get("observations", [])),
        nominal=_model_text(nominal),
        refused=refused,
    )


def _model_text(nominal: Mapping[str, Any]) -> str:
    """The first model in words."""
    if "mjcf" in nominal:
        return f"The nominal model is {nominal['mjcf']}."
    if "family" not in nominal:
        return ""
    numbers = ", ".join(f"{name} = {value:.4g}" for name, value in nominal["parameters"].items())
    return (
        f"The nominal model is {nominal['family']}, {FAMILIES.get(nominal['family'], '')}, per "
        f"unit inertia, with {numbers}. It has no friction and no delay; a diagnosis starts there."
    )
