"""An index of the routes: a request finds its own without trying those before it.

The framework tries the routes in order, a regular expression each, which takes longer than most
answers. A request that the index does not know is left to the framework, which then says why.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from fastapi.routing import APIRoute
from starlette.routing import BaseRoute, Match
from starlette.types import Receive, Scope, Send

Literals = tuple[str | None, ...]  # the segments of a path, None for each parameter


class RouteIndex(BaseRoute):
    """Stands in front of the routes that it knows, and for whichever matches whole."""

    def __init__(self, routes: Iterable[BaseRoute]) -> None:
        self._shapes: dict[tuple[str, int], list[tuple[bool, ...]]] = {}
        self._routes: dict[tuple[str, Literals], APIRoute] = {}
        for route in routes:
            if isinstance(route, APIRoute) and ":" not in route.path:
                self._add(route)

    def _add(self, route: APIRoute) -> None:
        literals = tuple(None if "{" in s else s for s in route.path.split("/"))
        shape = tuple(literal is not None for literal in literals)
        for method in route.methods or ():
            shapes = self._shapes.setdefault((method, len(shape)), [])
            if shape not in shapes:
                shapes.append(shape)
                shapes.sort(reverse=True)  # more literal first, as in /jobs/events and /jobs/{job}
            self._routes.setdefault((method, literals), route)

    def matches(self, scope: Scope) -> tuple[Match, Scope]:
        """The route's own match, and `Match.NONE` where it is none or only in part."""
        if scope["type"] == "http":
            method, segments = scope["method"], scope["path"].split("/")
            for shape in self._shapes.get((method, len(segments)), ()):
                route = self._routes.get((method, _literals(segments, shape)))
                if route is not None:
                    match, matched = route.matches(scope)
                    if match is Match.FULL:
                        return match, matched
        return Match.NONE, {}

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle a request as the route that matched."""
        await scope["route"].handle(scope, receive, send)


def _literals(segments: Sequence[str], shape: Sequence[bool]) -> Literals:
    return tuple([s if literal else None for s, literal in zip(segments, shape, strict=True)])
