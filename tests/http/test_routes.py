"""Routes are found as the framework finds them, and direct ones answer as the others do."""

import json
import uuid

import pytest
from starlette.routing import Match

from tests.http.test_http import accepted, problem, request
from tests.support.made import plant_document
from trueup_service.http.app import PAGES, ROUTERS
from trueup_service.http.route_index import RouteIndex

ROUTES = [route for module in (*ROUTERS, *PAGES) for route in module.router.routes]
DIGEST = "0" * 64
JSON = {"Content_Type": "application/json"}


def scope_of(method, path):
    return {"type": "http", "method": method, "path": path, "root_path": "", "path_params": {}}


def as_the_framework(scope):
    return next((r for r in ROUTES if r.matches(dict(scope))[0] is Match.FULL), None)


def paths():
    """A path of each route, with values that are also words of other paths."""
    for route in ROUTES:
        for value in ("p", "events", "serving", DIGEST, "plants", "a.b"):
            segments = [value if "{" in s else s for s in route.path.split("/")]
            for method in ("GET", "POST", "DELETE", "PUT"):
                yield method, "/".join(segments)


def test_the_index_finds_what_the_framework_finds():
    index, count = RouteIndex(ROUTES), 0
    for method, path in paths():
        scope = scope_of(method, path)
        match, matched = index.matches(dict(scope))
        expected = as_the_framework(scope)
        if match is Match.FULL:
            assert matched["route"] is expected, (method, path)
            count += 1
        else:
            assert expected is None or ":" in expected.path, (method, path)
    assert count > len(ROUTES)


def test_what_the_index_does_not_know_is_the_framework_s(service):
    assert problem(service, "GET", "/v1/nothing")[0] == 404
    assert problem(service, "PATCH", "/v1/plants")[0] == 405


@pytest.fixture
def promoted(service, client):
    plant = f"p{uuid.uuid4().hex[:12]}"
    client.register_plant(plant_document(plant))
    return plant, accepted(client, plant, 1.2)


def test_a_direct_route_refuses_as_the_framework_does(service, promoted):
    plant, decision = promoted
    path = f"/v1/plants/{plant}/serving/promote"
    body = {"decision": decision, "expected_generation": 1}
    for sent, headers, field in (
        ({**body, "expected_generation": 0}, JSON, "body.expected_generation"),
        ({**body, "more": 1}, JSON, "body.more"),
        ({"decision": decision}, JSON, "body.expected_generation"),
        (body, {**JSON, "Idempotency_Key": "k" * 256}, "header.Idempotency-Key"),
        (body, {**JSON, "Trueup_Actor": "a" * 201}, "header.Trueup-Actor"),
    ):
        status, code, facts = problem(service, "POST", path, json.dumps(sent), **headers)[:3]
        assert (status, code) == (422, "invalid-request")
        assert field in str(facts), (field, facts)
    assert problem(service, "POST", path, b"{", **JSON)[:2] == (422, "invalid-request")
    assert problem(service, "POST", path, json.dumps(body), Content_Type="text/plain")[0] == 422
    assert problem(service, "POST", "/v1/plants/P%20/serving/promote", json.dumps(body), **JSON)[
        0
    ] in (404, 422)
    status, _, _ = request(
        service, "POST", path, json.dumps(body), Content_Type="application/json; charset=utf-8"
    )
    assert status == 200  # not plain, and still right
