"""Routes that fleets use most. The framework takes longer to read the parameters of a request than
most endpoints take to answer it; here they are read without it.

An endpoint is written and documented as any other, and returns a response. A request is plain if
its path, its headers and its one JSON body are as the endpoint declares them. Any other is left to
the framework, which refuses it as it does on every route.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any, cast

from fastapi import APIRouter, Request, Response
from fastapi.dependencies.models import Dependant
from pydantic import BaseModel, ValidationError
from starlette.types import Message, Receive, Scope, Send

from trueup_service.http.guard import Guarded

JSON = "application/json"
Endpoint = Callable[..., Awaitable[Response]]


class Direct(Guarded):
    """A route whose endpoint takes parameters of the path, headers, one JSON body and what depends
    on those, and gives a response."""

    def __init__(self, path: str, endpoint: Any, **options: Any) -> None:
        super().__init__(path, endpoint, **options)
        self._parameters = _Parameters(self.dependant)

    async def answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer by the endpoint where the request is plain, and by the framework otherwise."""
        request = Request(scope, receive, send)
        try:
            arguments = await self._parameters.of(request)
        except _NotPlainError:
            await super().answer(scope, _again(request, receive), send)
            return
        response = await self.endpoint(**arguments)
        await response(scope, receive, send)


def direct(
    router: APIRouter, method: str, path: str, **options: Any
) -> Callable[[Endpoint], Endpoint]:
    """A decorator that makes a direct route of an endpoint, with the options of `APIRouter.get`."""

    def register(endpoint: Endpoint) -> Endpoint:
        router.add_api_route(
            path, endpoint, methods=[method], route_class_override=Direct, **options
        )
        return endpoint

    return register


class _NotPlainError(Exception):
    """A request is not as the route declares."""


class _Parameters:
    """The parameters of an endpoint, or of what it depends on."""

    def __init__(self, dependant: Dependant) -> None:
        if dependant.query_params or dependant.cookie_params or len(dependant.body_params) > 1:
            raise TypeError(f"a direct route cannot read all that {dependant.call} takes")
        self._request = dependant.request_param_name
        self._path = [(field.name, field) for field in dependant.path_params]
        self._headers = [(field.name, field) for field in dependant.header_params]
        self._bodies: list[tuple[str, type[BaseModel]]] = [
            (field.name, cast(type[BaseModel], field.field_info.annotation))
            for field in dependant.body_params
        ]
        self._nested = [
            (cast(str, one.name), cast(Any, one.call), _Parameters(one))
            for one in dependant.dependencies
        ]

    async def of(self, request: Request) -> dict[str, Any]:
        """Their values in a request. Raises _NotPlainError."""
        values: dict[str, Any] = {} if self._request is None else {self._request: request}
        for name, field in self._path:
            values[name] = _valid(field, request.path_params[field.alias])
        for name, field in self._headers:
            text = request.headers.get(field.alias)
            values[name] = field.get_default() if text is None else _valid(field, text)
        for name, call, parameters in self._nested:
            values[name] = await call(**await parameters.of(request))
        for name, model in self._bodies:
            if request.headers.get("content-type") != JSON:
                raise _NotPlainError
            try:
                values[name] = model.model_validate_json(await request.body())
            except ValidationError as error:
                raise _NotPlainError from error
        return values


def _valid(field: Any, value: str) -> Any:
    valid, errors = field.validate(value)
    if errors:
        raise _NotPlainError
    return valid


def _again(request: Request, receive: Receive) -> Receive:
    """What gives a body that was read once more."""
    read = getattr(request, "_body", None)
    sent = read is None

    async def again() -> Message:
        nonlocal sent
        if sent:
            return await receive()
        sent = True
        return {"type": "http.request", "body": read, "more_body": False}

    return again
