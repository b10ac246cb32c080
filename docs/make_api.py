"""Write api.md from the OpenAPI document that the service answers with, and from its errors."""

import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from trueup_service.http.app import create_app
from trueup_service.http.statuses import STATUS
from trueup_service.settings import Settings
from trueup_service.wiring import build

HEAD = """# REST

What `GET /openapi.json` says, to be read. Every request but those that [everybody](access.md) may
make carries a token, every POST takes an `Idempotency-Key`, lists come in pages: `items`, and
`next` for the cursor of the following one. The [client](python.md) does all of that.

```python
import json
import os
import urllib.request

asked = urllib.request.Request(
    "http://127.0.0.1:8321/v1/plants/emps/serving",
    headers={"Authorization": f"Bearer {os.environ['TRUEUP_TOKEN']}"},
)
with urllib.request.urlopen(asked) as answer:
    print(json.load(answer)["artifact"], answer.headers["ETag"])
```

## Errors

An error is `application/problem+json`: `status`, a stable `code`, `detail` in words, what to do
next in `hint`, values for programs in `facts`, and `request_id`, which stands in the service's log,
too.

| code | status | what it says | what to do, unless `hint` knows better |
|---|---|---|---|
"""


def document() -> dict[str, Any]:
    """The document, from an application on storage that is thrown away."""
    with tempfile.TemporaryDirectory() as folder:
        parts = build(Settings(data_dir=Path(folder)))
        found = create_app(parts).openapi()
        parts.close()
    return found


def page() -> str:
    """The page."""
    told = document()
    return (
        HEAD
        + "\n".join(
            [
                *_errors(),
                "",
                *_routes(told),
                "## What is sent and answered",
                "",
                *_schemas(told["components"]["schemas"]),
            ]
        ).rstrip()
        + "\n"
    )


def _errors() -> Iterator[str]:
    for kind, status in sorted(STATUS.items(), key=lambda row: (row[1], row[0].code)):
        yield f"| `{kind.code}` | {status.value} | {_line(kind.__doc__)} | {_line(kind.hint)} |"


def _routes(told: Mapping[str, Any]) -> Iterator[str]:
    tag = None
    for path, methods in told["paths"].items():
        for method, route in methods.items():
            if route["tags"][0] != tag:
                tag = route["tags"][0]
                yield from (f"## Routes of {tag}", "")
            yield from (
                f"### `{method.upper()} {path}`",
                "",
                f"**{route['summary']}.** {_line(route.get('description'))}".rstrip(),
                "",
            )
            yield from _parameters(route.get("parameters", []))
            yield from (f"- {_body(route)}answers {_answers(route['responses'])}", "")


def _parameters(parameters: list[Mapping[str, Any]]) -> Iterator[str]:
    for p in parameters:
        if p["in"] != "path" and p["name"] not in ("Idempotency-Key", "Trueup-Actor"):
            marks = [p["in"], *(["needed"] if p.get("required") else [])]
            default = p["schema"].get("default")
            kind = _type(p["schema"]) + ("" if default in (None, "") else f", default `{default}`")
            meaning = _line(p.get("description"))
            yield f"- `{p['name']}` ({', '.join(marks)}): {kind}. {meaning}".rstrip()


def _body(route: Mapping[str, Any]) -> str:
    content = route.get("requestBody", {}).get("content", {})
    return (
        f"takes {', or '.join(_content(media, x['schema']) for media, x in content.items())}, "
        if content
        else ""
    )


def _answers(responses: Mapping[str, Any]) -> str:
    found = []
    for status, response in responses.items():
        if not status.endswith("XX"):
            content = response.get("content", {})
            said = ", or ".join(
                _content(media, x.get("schema", {})) for media, x in content.items()
            )
            found.append(
                f"{status} {said}".rstrip()
                + (", if it already existed" if response["description"].endswith("already") else "")
            )
    return "; ".join(found)


def _content(media: str, schema: Mapping[str, Any]) -> str:
    return _type(schema) if media == "application/json" else f"`{media}`"


def _schemas(schemas: Mapping[str, Any]) -> Iterator[str]:
    for name, schema in schemas.items():
        if name.startswith("Page_"):
            continue
        yield from (f"### {_name(name)}", "", _line(schema.get("description")), "")
        if "enum" in schema:
            yield from (f"One of {', '.join(f'`{x}`' for x in schema['enum'])}.", "")
        if schema.get("properties"):
            yield from ("| field | type | |", "|---|---|---|")
            needed = schema.get("required", ())
            for field, kind in schema["properties"].items():
                told = _line(kind.get("description"))
                default = (
                    ""
                    if field in needed or kind.get("default") is None
                    else f"default `{kind['default']}`"
                )
                yield (
                    f"| `{field}` | {_type(kind)} | {'; '.join(x for x in (told, default) if x)} |"
                )
            yield ""


def _type(schema: Mapping[str, Any]) -> str:
    """A schema in a few words, with links to those that have a name."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        if name.startswith("Page_"):
            inner = _name(name.removeprefix("Page_").removesuffix("_"))
            return f"a page of [{inner}](#{inner.lower()})"
        return f"[{_name(name)}](#{_name(name).lower()})"
    for several in ("anyOf", "oneOf", "allOf"):
        if several in schema:
            return " or ".join(_type(x) for x in schema[several])
    if "const" in schema or "enum" in schema:
        return " or ".join(f"`{x}`" for x in schema.get("enum", [schema.get("const")]))
    if schema.get("type") == "array":
        return f"list of {_type(schema.get('items', {}))}"
    words = {
        "object": "object",
        "string": "text",
        "integer": "integer",
        "number": "number",
        "boolean": "true or false",
        "null": "null",
    }
    bounds = [
        f"{word} {schema[key]:g}"
        for key, word in (("minimum", "from"), ("exclusiveMinimum", "above"), ("maximum", "to"))
        if key in schema
    ]
    return " ".join([words.get(schema.get("type", ""), "anything"), *bounds])


def _name(name: str) -> str:
    """A schema's name without the module that tells it from another of the same name."""
    parts = name.removesuffix("-Output").split("__")
    return parts[-1] if len(parts) == 1 else {"episode": "EpisodeRole"}.get(parts[1], parts[-1])


def _line(text: str | None) -> str:
    return " ".join((text or "").split()).replace("|", "\\|")


if __name__ == "__main__":
    (Path(__file__).parent / "api.md").write_text(page())
