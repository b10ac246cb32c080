"""People sign in at a real OpenID provider; tokens and sessions stay as they are."""

import base64
import http.cookiejar
import json
import re
import urllib.error
import urllib.parse
import urllib.request
from contextlib import closing

import pytest
from pydantic import ValidationError

from tests.support.made import plant_document
from tests.support.openid_provider import CLIENT, PASSWORD, SECRET, providing
from tests.support.service import ADMIN, Service, free_port
from tests.support.storage import Storage, embedded
from trueup_client import Client
from trueup_service.errors import Forbidden, SignInRefused
from trueup_service.http.openid import people_of
from trueup_service.settings import Settings

GROUPS = {
    "robotics": {"roles": ["engineer"]},
    "fleet": {"roles": ["operator", "auditor"]},
    "cell-7": {"roles": ["engineer"], "project": "cell-7"},
    "cell-8": {"roles": ["operator"], "project": "cell-8"},
    "lost": {"roles": ["engineer"], "project": "no-such-project"},
}


def person(name, *groups, **more):
    return {"email": f"{name}@example.com", "email_verified": True, "groups": list(groups), **more}


PEOPLE = {
    "ada": person("ada", "robotics", "fleet", "others"),
    "bob": person("bob", "cell-7"),
    "cyd": person("cyd", "cell-7", "cell-8"),
    "dan": person("dan", "others"),
    "eve": person("eve", "robotics", email_verified=False),
    "hal": person("hal", "fleet", "cell-7"),
    "fay": {"groups": ["robotics"]},
    "gus": person("gus", "lost"),
}


@pytest.fixture(scope="module")
def running(tmp_path_factory):
    """A service with a provider, both on this machine."""
    port = free_port()
    callback = f"http://127.0.0.1:{port}/sign-in/openid/callback"
    with providing(tmp_path_factory.mktemp("provider"), [callback], PEOPLE) as issuer:
        environment = embedded(tmp_path_factory.mktemp("data")).environment | {
            "TRUEUP_OPENID_ISSUER": issuer,
            "TRUEUP_OPENID_CLIENT_ID": CLIENT,
            "TRUEUP_OPENID_CLIENT_SECRET": SECRET,
            "TRUEUP_OPENID_GROUPS": json.dumps(GROUPS),
        }
        service = Service(Storage("openid", environment))
        service.port = port
        with service.running(worker=False), closing(Client(service.url)) as admin:
            for project in ("cell-7", "cell-8"):
                admin.create_project(project)
            yield service, admin, issuer


class Visitor:
    """A browser without scripts: it keeps cookies and follows redirects, and notes them."""

    def __init__(self, service):
        self.service, self.cookies, self.visited = service, http.cookiejar.CookieJar(), []
        visitor = self

        class Noting(urllib.request.HTTPRedirectHandler):
            def redirect_request(self, request, *rest):
                visitor.visited.append(rest[-1])
                return super().redirect_request(request, *rest)

        self._opener = urllib.request.build_opener(
            urllib.request.HTTPCookieProcessor(self.cookies), Noting()
        )

    def go(self, path, fields=None, **headers):
        url = path if path.startswith("http") else self.service.url + path
        data = None if fields is None else urllib.parse.urlencode(fields).encode()
        request = urllib.request.Request(url, data, {"Accept": "text/html", **headers})
        try:
            with self._opener.open(request) as answer:
                return answer.status, answer.read().decode(), answer.url
        except urllib.error.HTTPError as error:
            return error.code, error.read().decode(), error.url

    def sign_in(self, name, path="/sign-in/openid?next=/plants/p"):
        """Goes to the provider, gives a password there, and comes back."""
        _, page, url = self.go(path)
        token = re.search(r'name="csrfmiddlewaretoken" value="([^"]+)"', page)[1]
        fields = {"csrfmiddlewaretoken": token, "username": name, "password": PASSWORD}
        return self.go(url, fields, Referer=url)

    @property
    def session(self):
        return next((c for c in self.cookies if c.name == "trueup_session"), None)

    def who(self):
        status, body, _ = self.go("/v1/session")
        assert status == 200
        return json.loads(body)


def test_somebody_signs_in_and_holds_the_roles_of_all_groups(running):
    service, admin, _ = running
    visitor = Visitor(service)
    status, page, url = visitor.sign_in("ada")
    assert status == 200
    assert url.startswith(f"{service.url}/sign-in/openid/callback?")
    assert 'content="0; url=/plants/p"' in page
    who = visitor.who()
    assert (who["name"], who["project"], who["plant"]) == ("ada@example.com", None, None)
    assert set(who["roles"]) == {"engineer", "operator", "auditor"}
    (cookie,) = [c for c in visitor.cookies if c.name == "trueup_session"]
    assert cookie.get_nonstandard_attr("SameSite").lower() == "strict"
    assert cookie.has_nonstandard_attr("HttpOnly")
    assert not [c for c in visitor.cookies if c.name == "trueup_openid"]
    issued = [e for e in admin.audit() if e["facts"].get("name") == "ada@example.com"]
    assert [(e["kind"], e["actor"]) for e in issued] == [("token:issued", "OpenID provider")]
    # what somebody does stands in the log under their name
    visitor.go("/sign-out", {}, Origin=service.url)
    assert visitor.go("/v1/session", Accept="application/json")[0] == 401


def test_an_admin_ends_somebodys_session(running):
    service, admin, _ = running
    visitor = Visitor(service)
    visitor.sign_in("ada")
    for token in admin.tokens():
        if token["name"] == "ada@example.com" and token["revoked_at"] is None:
            admin.revoke_token(token["prefix"])
    assert visitor.go("/v1/session", Accept="application/json")[0] == 401


def test_a_project_bounds_what_somebody_sees(running):
    service, admin, _ = running
    admin.register_plant(plant_document("seven"), "cell-7")
    admin.register_plant(plant_document("eight"), "cell-8")
    visitor = Visitor(service)
    visitor.sign_in("bob")
    assert visitor.who()["project"] == "cell-7"
    plants = json.loads(visitor.go("/v1/plants", Accept="application/json")[1])["items"]
    assert [p["name"] for p in plants] == ["seven"]


def test_somebody_of_several_projects_chooses_one(running):
    service, _, _ = running
    visitor = Visitor(service)
    status, page, _ = visitor.sign_in("cyd")
    assert status == 200
    assert visitor.session is None
    links = re.findall(r'href="(/sign-in/openid\?[^"]+)"', page)
    assert len(links) == 2
    visitor.go(links[1].replace("&amp;", "&"))  # the provider knows the browser by now
    who = visitor.who()
    assert (who["project"], who["roles"]) == ("cell-8", ["operator"])


def test_somebody_of_all_projects_who_may_do_more_in_one_chooses(running):
    service, _, _ = running
    for number, (project, roles) in enumerate(
        ((None, {"operator", "auditor"}), ("cell-7", {"engineer", "operator", "auditor"}))
    ):
        visitor = Visitor(service)
        _, page, _ = visitor.sign_in("hal")
        assert visitor.session is None
        link = re.findall(r'href="(/sign-in/openid\?[^"]+)"', page)[number]
        visitor.go(link.replace("&amp;", "&"))
        assert (visitor.who()["project"], set(visitor.who()["roles"])) == (project, roles)


@pytest.mark.parametrize(
    ("name", "status", "words"),
    [
        ("dan", 403, "in no group that may sign in here"),
        ("eve", 403, "has not verified the address"),
        ("fay", 403, "gives no name in the claim"),
        ("gus", 404, "no-such-project"),
    ],
)
def test_others_are_refused_on_the_sign_in_page(running, name, status, words):
    visitor = Visitor(running[0])
    answer = visitor.sign_in(name)
    assert answer[0] == status
    assert words in answer[1]
    assert "/sign-in/openid?next=" in answer[1]  # to try again
    assert visitor.session is None


def test_the_flow_has_pkce_state_and_nonce_that_are_new_each_time(running):
    service, _, issuer = running
    asked = []
    for _ in range(2):
        visitor = Visitor(service)
        visitor.go("/sign-in/openid")
        authorize = next(v for v in visitor.visited if "/authorize" in v)
        assert authorize.startswith(f"{issuer}/authorize/")
        asked.append(dict(urllib.parse.parse_qsl(urllib.parse.urlsplit(authorize).query)))
    one, other = asked
    assert one["code_challenge_method"] == "S256"
    assert one["scope"] == "openid profile email"
    for name in ("state", "nonce", "code_challenge"):
        assert len(one[name]) >= 20
        assert one[name] != other[name]


def callback_of(visitor, name="ada"):
    """The address to which the provider sends a browser back."""
    visitor.sign_in(name)
    return next(v for v in visitor.visited if "/sign-in/openid/callback" in v)


def test_an_answer_is_taken_once_and_by_the_browser_that_asked(running):
    service, _, _ = running
    visitor = Visitor(service)
    callback = callback_of(visitor)
    # again, in the browser that used it, and in another one
    for somebody in (visitor, Visitor(service)):
        somebody.cookies.clear()
        status, page, _ = somebody.go(callback)
        assert status == 403
        assert "o sign-in is under way in this browser" in page
        assert somebody.session is None
    # in a browser with a sign-in of its own under way
    other = Visitor(service)
    other.go("/sign-in/openid")
    status, page, _ = other.go(callback)
    assert status == 403
    assert other.session is None


def test_a_stolen_code_is_worth_nothing_without_its_verifier(running):
    service, _, _ = running
    victim, thief = Visitor(service), Visitor(service)
    stopped = {}

    class Stop(urllib.request.HTTPRedirectHandler):
        def redirect_request(self, request, fp, code, msg, headers, newurl):
            if "/callback" in newurl:
                stopped["url"] = newurl
                return None
            return super().redirect_request(request, fp, code, msg, headers, newurl)

    victim._opener = urllib.request.build_opener(
        urllib.request.HTTPCookieProcessor(victim.cookies), Stop()
    )
    victim.sign_in("ada")
    code = dict(urllib.parse.parse_qsl(urllib.parse.urlsplit(stopped["url"]).query))["code"]
    thief.go("/sign-in/openid")
    state = next(
        dict(urllib.parse.parse_qsl(urllib.parse.urlsplit(v).query))["state"]
        for v in thief.visited
        if "/authorize" in v
    )
    status, _, _ = thief.go(f"/sign-in/openid/callback?code={code}&state={state}")
    assert status == 403
    assert thief.session is None


@pytest.mark.parametrize(
    "query",
    ["", "?code=x", "?state=x", "?code=x&state=y", "?error=access_denied&error_description=no"],
)
def test_a_callback_that_nobody_asked_for_is_refused(running, query):
    visitor = Visitor(running[0])
    assert visitor.go(f"/sign-in/openid/callback{query}")[0] == 403
    visitor.go("/sign-in/openid")
    status, page, _ = visitor.go(f"/sign-in/openid/callback{query}")
    assert status in (403, 502)
    assert "Sign in" in page


@pytest.mark.parametrize("cookie", ["x", "e30", base64.b64encode(b"[]").decode(), "=" * 40])
def test_a_cookie_of_somebodys_own_making_is_refused(running, cookie):
    status, _, _ = Visitor(running[0]).go(
        "/sign-in/openid/callback?code=x&state=y", Cookie=f"trueup_openid={cookie}"
    )
    assert status == 403


@pytest.mark.parametrize(
    "to", ["https://evil.example", "//evil.example", "/\\evil", "javascript:x"]
)
def test_nobody_is_sent_to_another_site(running, to):
    visitor = Visitor(running[0])
    _, page, _ = visitor.sign_in("ada", f"/sign-in/openid?next={urllib.parse.quote(to)}")
    assert 'content="0; url=/"' in page


def test_the_sign_in_page_offers_it_and_tokens_go_on(running):
    service, _, _ = running
    _, page, _ = Visitor(service).go("/sign-in?next=/plants/p")
    assert "Sign in with your organisation" in page
    assert 'name="token"' in page
    visitor = Visitor(service)
    visitor.go("/sign-in", {"token": ADMIN}, Origin=service.url)
    assert visitor.who()["name"] == "admin"


def test_a_provider_that_is_away_or_another_is_told(tmp_path):
    for issuer, words in (
        (f"http://127.0.0.1:{free_port()}", "does not answer"),
        ("http://127.0.0.1:{port}", "does not answer"),
    ):
        environment = embedded(tmp_path / "data").environment | {
            "TRUEUP_OPENID_CLIENT_ID": CLIENT,
            "TRUEUP_OPENID_GROUPS": json.dumps(GROUPS),
        }
        service = Service(Storage("away", environment))
        service.storage.environment["TRUEUP_OPENID_ISSUER"] = issuer.format(port=service.port)
        with service.running(worker=False):
            status, page, _ = Visitor(service).go("/sign-in/openid")
            assert status == 502
            assert words in page
            assert 'name="token"' in page


def test_without_a_provider_all_is_as_before(tmp_path):
    with Service(embedded(tmp_path / "data")).running(worker=False) as service:
        visitor = Visitor(service)
        assert "/sign-in/openid" not in visitor.go("/sign-in")[1]
        assert visitor.go("/sign-in/openid")[0] == 404
        assert visitor.go("/sign-in/openid/callback?code=x&state=y")[0] == 404


def test_settings_of_a_provider_are_whole(tmp_path):
    with pytest.raises(ValidationError, match="TRUEUP_OPENID_CLIENT_ID"):
        Settings(data_dir=tmp_path, openid_issuer="https://accounts.example.com")
    with pytest.raises(ValidationError):
        Settings(data_dir=tmp_path, openid_groups={"g": {"roles": ["robot"]}})


def settings(**more):
    return Settings(openid_issuer="https://i", openid_client_id="c", openid_groups=GROUPS, **more)


VERIFIED = {"email": "a@b", "email_verified": True}


def test_groups_come_as_a_list_or_one_as_text():
    for groups, roles in (
        (["robotics", "fleet"], ("engineer", "operator", "auditor")),
        ("robotics", ("engineer",)),
    ):
        (one,) = people_of(VERIFIED | {"groups": groups}, settings())
        assert (one.roles, one.project) == (roles, None)
    # a blank in the name of a group makes nobody a member of two
    for groups in (None, [], 7, {"robotics": True}, "robot", "others fleet", "others,fleet"):
        with pytest.raises(Forbidden):
            people_of(VERIFIED | {"groups": groups}, settings())


@pytest.mark.parametrize(
    ("verified", "passes"),
    [
        (True, True),
        ("true", True),
        (False, False),
        ("false", False),
        (None, False),
        (1, True),
    ],
)
def test_an_email_counts_if_the_provider_has_verified_it(verified, passes):
    claims = {"email": "a@b", "email_verified": verified, "groups": ["fleet"]}
    if passes:
        assert people_of(claims, settings())[0].name == "a@b"
    else:
        with pytest.raises(SignInRefused, match="verified"):
            people_of(claims, settings())
    with pytest.raises(SignInRefused, match="verified"):
        people_of({"email": "a@b", "groups": ["fleet"]}, settings())


def test_a_name_is_one_line_of_the_claim_that_was_chosen():
    claims = VERIFIED | {"preferred_username": "ada", "groups": ["fleet"]}
    (one,) = people_of(claims, settings(openid_name_claim="preferred_username"))
    assert one.name == "ada"
    for name in ("", None, 7, "a\nb", "\u202eada", "x" * 101):
        with pytest.raises(SignInRefused):
            people_of(claims | {"email": name}, settings())


def test_somebody_of_all_projects_and_of_one_may_be_either():
    claims = VERIFIED | {"groups": ["cell-8", "robotics", "cell-7"]}
    assert [(p.project, p.roles) for p in people_of(claims, settings())] == [
        (None, ("engineer",)),
        ("cell-8", ("engineer", "operator")),  # in cell-7 they may do nothing else
    ]
