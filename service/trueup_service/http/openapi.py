"""The OpenAPI document: what the framework derives from the routes, with every refusal as a
problem."""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic import BaseModel

from trueup_service.http.problems import MEDIA_TYPE
from trueup_service.http.schemas.wire import Problem

METHODS = ("get", "put", "post", "patch", "delete")


def already_exists(model: type[BaseModel]) -> dict[int | str, dict[str, Any]]:
    """The 200 response of a route that makes something, where it exists already."""
    return {200: {"model": model, "description": "It was there already"}}


def install(app: FastAPI) -> None:
    """Give the application its OpenAPI document, which is made once."""

    def document() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = _with_problems(
                get_openapi(
                    title=app.title,
                    version=app.version,
                    description=app.description,
                    routes=app.routes,
                )
            )
        return app.openapi_schema

    app.openapi = document  # type: ignore[method-assign]


def _with_problems(document: dict[str, Any]) -> dict[str, Any]:
    schemas = document["components"]["schemas"]
    schemas["Problem"] = Problem.model_json_schema()
    for unused in ("HTTPValidationError", "ValidationError"):
        schemas.pop(unused, None)
    refused = {
        "description": "Refused",
        "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}},
    }
    for path in document["paths"].values():
        for method in METHODS:
            if method in path:
                path[method]["responses"].pop("422", None)
                path[method]["responses"] |= {"4XX": refused, "5XX": refused}
    return document
