"""Polling of what serves: a response at once, 304 where nothing changed, or a response at the next
move."""

from __future__ import annotations

from typing import Any

from fastapi import Request, Response

from trueup_service.errors import BadRequest
from trueup_service.http.headers import header
from trueup_service.http.serving_answers import ServingAnswers, matches

UNCHANGED: dict[int | str, dict[str, Any]] = {
    304: {"description": "Still what If-None-Match names"}
}
PLANT = {
    "name": "plant",
    "in": "path",
    "required": True,
    "schema": {"type": "string"},
    "description": "A plant's name",
}
ASKED: tuple[dict[str, Any], ...] = (
    {
        "name": "wait_s",
        "in": "query",
        "schema": {"type": "number", "minimum": 0, "default": 0},
        "description": "With If-None-Match: wait this long for a change [s]",
    },
    {
        "name": "If-None-Match",
        "in": "header",
        "schema": {"type": "string"},
        "description": "The tag of the answer that the caller has",
    },
)


async def polled(request: Request, plant: str, channel: str | None = None) -> Response:
    """The response with what a plant's pointer or one of its channels serves. Raises NotFound,
    BadRequest.

    Fleets poll this, so the parameters are read without the framework, which halves the cost of a
    response.
    """
    answers: ServingAnswers = request.app.state.answers
    tag = header(request.scope, b"if-none-match").decode("latin-1")
    wait_s = (
        _wait_s(request, request.app.state.parts.settings.long_poll_limit_s)
        if request.scope["query_string"]
        else 0.0
    )
    answer = (
        await answers.after((plant, channel), tag, wait_s)
        if tag and wait_s
        else await answers.now((plant, channel))
    )
    return answer.unchanged if tag and matches(answer.etag, tag) else answer.whole


def _wait_s(request: Request, limit_s: float) -> float:
    try:
        wait_s = float(request.query_params.get("wait_s", "0"))
    except ValueError:
        wait_s = -1.0
    if not wait_s >= 0.0:  # nan is not
        raise BadRequest("wait_s must be a number of seconds, 0 or more")
    return min(wait_s, limit_s)
