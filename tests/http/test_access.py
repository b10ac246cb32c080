"""Who may do what: the matrix against the running service, projects, tokens, sessions."""

import ast
import json
import socket
import uuid
from contextlib import closing

import pytest

from tests.http.test_http import problem, request
from tests.support.gates import IMPROVING, declare_following
from tests.support.made import episode_bytes, identified, plant_document, save
from tests.support.service import ADMIN, ROOT, Service, command
from tests.support.storage import embedded
from trueup.episode.role import Role as Purpose
from trueup_client import Client, Problem
from trueup_service.authentication import Authenticator, first_admin, new_token
from trueup_service.errors import Unauthenticated
from trueup_service.http.access import ACCESS
from trueup_service.http.app import PAGES, ROUTERS
from trueup_service.http.guard import Guarded
from trueup_service.registry.records import Role
from trueup_service.settings import Settings
from trueup_service.wiring import build

NOTHING = {
    "digest": "0" * 64,
    "draft": "0" * 64,
    "job": "0" * 32,
    "alarm": "0" * 32,
    "version": "99",
    "channel": "none",
    "prefix": "0" * 12,
    "table": "plants",
    "name": "none",
    "kind": "openloop",  # a study's; labels know no such kind, and refuse it
    "subject": "0" * 64,
    "webhook": "none",
}
ROUTES = [
    (method, route)
    for module in (*ROUTERS, *PAGES)
    for route in module.router.routes
    for method in sorted(route.methods)
]


# a stream has no end: what a role may see of it, tests of its own say
STREAMS = {("GET", "/live")}


def bearer(token):
    return {"Authorization": f"Bearer {token}"}


@pytest.fixture(scope="module")
def somebody(service):
    """Two projects with a plant each; a token for each role in the first, of all projects, and an
    engineer's in the second."""
    mark = uuid.uuid4().hex[:8]
    with closing(Client(service.url)) as admin:
        ours, theirs = (
            admin.create_project(f"{name}-{mark}")["name"] for name in ("ours", "theirs")
        )
        for project in (ours, theirs):
            admin.register_plant(plant_document(f"plant-of-{project}"), project)
        tokens = {
            role: admin.issue_token(
                role, [role], ours, f"plant-of-{ours}" if role == Role.ROBOT else None
            )["token"]
            for role in Role
        }
        tokens |= {
            f"{role} of all": admin.issue_token(role, [role])["token"]
            for role in Role
            if role != Role.ROBOT
        }
        tokens["other"] = admin.issue_token("other", ["engineer", "operator"], theirs)["token"]
    return {"ours": f"plant-of-{ours}", "theirs": f"plant-of-{theirs}", "project": theirs, **tokens}


# -- the matrix


def test_every_route_is_guarded_and_has_a_row_and_every_row_a_route():
    assert all(isinstance(route, Guarded) for _, route in ROUTES)
    assert {(method, route.path) for method, route in ROUTES} == set(ACCESS)


@pytest.mark.parametrize(
    "role", [*Role, *(f"{role} of all" for role in Role if role != Role.ROBOT), None]
)
def test_every_route_answers_every_role_as_its_row_says(service, somebody, role):
    headers = bearer(somebody[role]) if role else {"Authorization": "none"}
    everywhere = role is not None and role.endswith("of all")
    for method, route in ROUTES:
        rule = ACCESS[method, route.path]
        if role is not None and (method, route.path) in STREAMS:
            continue
        path = (
            route.path.replace("{tile:path}", "000")
            .replace("{level}", "0")
            .replace("{plant}", somebody["ours"])
        )
        status, _, body = request(
            service, method, path.format(**NOTHING), b"", **headers, Content_Type="application/json"
        )
        code = json.loads(body).get("code") if status >= 400 else None
        allowed = role is not None and (
            Role(role.split()[0]) in rule.roles and (everywhere or not rule.everywhere)
        )
        if rule.public:
            assert code != "unauthenticated", (method, route.path)
        elif role is None:
            assert (status, code) == (401, "unauthenticated"), (method, route.path)
        else:
            assert (code != "forbidden") == allowed, (role, method, route.path, status)
            assert code != "unauthenticated", (role, method, route.path)
            assert status < 500, (role, method, route.path, status)
    with closing(Client(service.url)) as admin:  # a form without an answer asks for a job
        for job in admin.queue():
            admin.cancel(job["id"])


def test_the_page_of_the_matrix_is_true():
    page = (ROOT / "docs" / "access.md").read_text()
    assert all(f"`{method} {path}`" in page for method, path in ACCESS)


# -- projects


def test_what_is_of_another_project_answers_as_what_does_not_exist(service, somebody):
    job, decision = "f" * 32, "f" * 64
    known = bearer(somebody["other"])
    for method, route in ROUTES:
        rule = ACCESS[method, route.path]
        if (
            rule.public
            or rule.everywhere
            or not rule.roles & {Role.ENGINEER, Role.OPERATOR}
            or "{plant}" not in route.path
        ):
            continue
        answers = []
        for plant in (somebody["ours"], "nobody-has-this"):
            path = route.path.replace("{plant}", plant).format(**NOTHING)
            status, _, body = request(
                service, method, path, b"{}", **known, Content_Type="application/json"
            )
            answers.append((status, body.decode().replace(plant, "PLANT").split('"request_id"')[0]))
        assert answers[0] == answers[1], (method, route.path)
        assert answers[0][0] == 404
    assert problem(service, "GET", f"/v1/jobs/{job}", **known)[0] == 404
    assert problem(service, "GET", f"/v1/decisions/{decision}", **known)[0] == 404


def test_jobs_and_decisions_of_another_project_are_unknown_by_their_ids(
    service, somebody, tmp_path
):
    from tests.http.test_http import move

    with closing(Client(service.url, token=somebody["admin of all"])) as admin:
        move(admin, somebody["ours"], 1.2)
        decision = next(admin.decisions(somebody["ours"]))
    path = f"/v1/decisions/{decision['digest']}"
    assert request(service, "GET", path, **bearer(somebody[Role.ENGINEER]))[0] == 200
    assert problem(service, "GET", path, **bearer(somebody["other"]))[:2] == (404, "not-found")
    job = f"/v1/jobs/{decision['job']}"
    assert request(service, "GET", job, **bearer(somebody[Role.ENGINEER]))[0] == 200
    assert problem(service, "GET", job, **bearer(somebody["other"]))[:2] == (404, "not-found")
    assert problem(service, "POST", f"{job}/cancel", **bearer(somebody["other"]))[:2] == (
        404,
        "not-found",
    )


def test_each_sees_its_own_plants_and_its_own_part_of_the_log(service, somebody):
    with (
        closing(Client(service.url, token=somebody["other"])) as other,
        closing(Client(service.url, token=somebody[Role.AUDITOR])) as auditor,
    ):
        assert [p["name"] for p in other.plants()] == [somebody["theirs"]]
        assert {e["plant"] for e in auditor.audit()} == {somebody["ours"]}
        with pytest.raises(Problem) as refused:
            other.register_plant(plant_document(somebody["ours"]))
        assert (refused.value.code, refused.value.facts) == ("conflict", {})
        mine = other.register_plant(plant_document(f"p{uuid.uuid4().hex[:8]}"))
        assert mine["project"] == somebody["project"]
        with pytest.raises(Problem) as refused:
            other.register_plant(plant_document("x"), "no-such-project")
        assert refused.value.status == 404


def test_a_robot_has_its_own_plant_and_nothing_else(service, somebody, tmp_path):
    with closing(Client(service.url, token=somebody[Role.ROBOT])) as robot:
        assert robot.serving(somebody["ours"]).version >= 1
        robot.fetch(somebody["ours"], robot.serving(somebody["ours"]).artifact, tmp_path / "model")
        assert robot.checkpoint()
        for act, status in (
            (lambda: robot.serving(somebody["theirs"]), 404),
            (lambda: robot.roll_back(somebody["ours"], 1), 403),
            (lambda: list(robot.audit()), 403),
        ):
            with pytest.raises(Problem) as refused:
                act()
            assert refused.value.status == status


# -- tokens


def test_a_token_is_shown_once_and_kept_as_a_hash(service):
    with closing(Client(service.url)) as admin:
        made = admin.issue_token("once", ["auditor"])
        listed = next(t for t in admin.tokens() if t["prefix"] == made["prefix"])
        assert "token" not in listed
        assert made["token"].startswith(f"trueup_{made['prefix']}_")
        secret = made["token"].split("_", 2)[2]  # of base64url, which has underscores of its own
        assert secret not in json.dumps(list(admin.rows("tokens"))) + json.dumps(
            list(admin.audit())
        )


def test_a_revoked_an_expired_and_a_forged_token_are_refused(service):
    with closing(Client(service.url)) as admin:
        made, brief, alive = (
            admin.issue_token("gone", ["auditor"]),
            admin.issue_token("brief", ["auditor"], days=1e-9),
            admin.issue_token("alive", ["auditor"])["token"],
        )
        assert request(service, "GET", "/v1/session", **bearer(made["token"]))[0] == 200
        admin.revoke_token(made["prefix"])
        with pytest.raises(Problem) as refused:
            admin.revoke_token(made["prefix"])
        assert refused.value.code == "conflict"
    assert request(service, "GET", "/v1/session", **bearer(alive))[0] == 200
    for token in (
        made["token"],
        brief["token"],
        f"trueup_{alive.split('_')[1]}_{'x' * 43}",
        alive[:-1] + ("A" if alive[-1] != "A" else "E"),
        "",
        "x",
        "trueup__",
        "\u00e4".encode().decode("latin-1"),
        ADMIN[:-1],
    ):
        assert problem(service, "GET", "/v1/session", **bearer(token))[:2] == (
            401,
            "unauthenticated",
        ), token


def test_a_robots_token_is_of_one_plant(service):
    with closing(Client(service.url)) as admin:
        for wrong in ({"roles": ["robot"]}, {"roles": ["robot", "admin"], "plant": "x"}):
            with pytest.raises(Problem) as refused:
                admin.issue_token("r2d2", **wrong)
            assert refused.value.code == "bad-request"
        with pytest.raises(Problem) as refused:
            admin.issue_token("lost", ["engineer"], project="no-such-project")
        assert refused.value.code == "not-found"


def test_another_server_refuses_a_revoked_token_once_it_asks_again(tmp_path):
    parts, clock = build(Settings(data_dir=tmp_path, admin_token=None)), [0.0]
    path = first_admin(parts.settings, parts.database)
    assert first_admin(parts.settings, parts.database) is None
    assert path.stat().st_mode & 0o777 == 0o600
    token, one, other = (
        path.read_text().strip(),
        *(Authenticator(parts.settings, parts.database, lambda: clock[0]) for _ in range(2)),
    )
    assert one.by_token(token) == other.by_token(token) == other.remembered(token)
    from trueup_service.actions.tokens import revoke_token
    from trueup_service.actor_context import ActorContext
    from trueup_service.registry.transaction import writing

    with writing(parts.database) as tx:
        revoke_token(tx, token.split("_")[1], ActorContext("tester", "2026-01-01T00:00:00.000000Z"))
    one.forget()
    with pytest.raises(Unauthenticated):
        one.by_token(token)
    assert other.remembered(token) is not None
    clock[0] = parts.settings.token_memory_s + 0.01
    assert other.remembered(token) is None
    with pytest.raises(Unauthenticated):
        other.by_token(token)
    parts.close()


def test_a_service_that_is_started_the_first_time_listens_here_alone_and_makes_an_admin(
    tmp_path, monkeypatch
):
    monkeypatch.delenv("TRUEUP_ADMIN_TOKEN")
    monkeypatch.delenv("TRUEUP_TOKEN")
    service = Service(embedded(tmp_path / "data"))
    with service.running():
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.2", service.port), 5.0)
        kept = tmp_path / "data" / "admin.token"
        assert kept.stat().st_mode & 0o777 == 0o600
        assert (tmp_path / "data").stat().st_mode & 0o077 == 0
        monkeypatch.setenv("TRUEUP_DATA_DIR", str(tmp_path / "data"))
        assert "admin" in command(service, "whoami").stdout
        monkeypatch.setenv("TRUEUP_DATA_DIR", str(tmp_path / "nowhere"))
        refused = command(service, "whoami", check=False)
        assert (
            refused.returncode,
            "unauthenticated" in refused.stderr,
            "trueup login" in refused.stderr,
        ) == (1, True, True)


def test_signing_in_at_the_command_keeps_a_token_for_its_address(service, monkeypatch, tmp_path):
    import subprocess
    import sys

    monkeypatch.delenv("TRUEUP_TOKEN")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    login = [sys.executable, "-m", "trueup_cli.main", "login", "--url", service.url]
    done = subprocess.run(
        login, input=ADMIN + "\n", text=True, capture_output=True, check=False, cwd=ROOT
    )
    assert done.returncode == 0, done.stderr
    kept = next((tmp_path / "trueup" / "tokens").iterdir())
    assert (kept.read_text(), kept.stat().st_mode & 0o777) == (ADMIN, 0o600)
    issued = command(service, "token", "issue", "ada", "engineer", "operator", "--days", "7")
    assert issued.stdout.startswith("trueup_")
    prefix = issued.stdout.split("_")[1]
    listed = command(service, "token", "list").stdout
    assert [line for line in listed.splitlines() if prefix in line and "ada" in line]
    assert "revoked" in command(service, "token", "revoke", prefix).stdout
    assert "is there" in command(service, "project", "create", "lab").stdout
    assert "lab" in command(service, "project", "list").stdout


# -- sessions of browsers


def sign_in(service, token=ADMIN):
    status, headers, _ = request(
        service,
        "POST",
        "/v1/session",
        json.dumps({"token": token}),
        Content_Type="application/json",
    )
    assert status == 200
    return headers["set-cookie"]


def test_a_session_is_a_cookie_that_scripts_do_not_see_and_other_sites_do_not_send(service):
    cookie = sign_in(service)
    assert {"HttpOnly", "SameSite=strict", "Path=/"} <= {part.strip() for part in cookie.split(";")}
    assert ADMIN not in cookie
    known = {"Authorization": None, "Cookie": cookie.split(";")[0]}
    assert json.loads(request(service, "GET", "/v1/session", **known)[2])["name"] == "admin"
    body = json.dumps({"name": f"p{uuid.uuid4().hex[:8]}"})
    here = f"http://127.0.0.1:{service.port}"
    for origin, status in ((None, 403), ("http://evil.example", 403), ("null", 403), (here, 201)):
        asked = request(
            service,
            "POST",
            "/v1/projects",
            body,
            **known,
            Origin=origin,
            Content_Type="application/json",
        )
        assert asked[0] == status, origin
    elsewhere = request(
        service,
        "POST",
        "/v1/projects",
        body,
        **known,
        Origin=here,
        Sec_Fetch_Site="same-site",
        Content_Type="application/json",
    )
    assert elsewhere[0] == 403
    known["Origin"] = here
    assert request(service, "DELETE", "/v1/session", **known)[0] == 204
    assert problem(service, "GET", "/v1/session", **known)[:2] == (401, "unauthenticated")


def test_a_session_ends_with_its_token(service):
    with closing(Client(service.url)) as admin:
        made = admin.issue_token("brief", ["auditor"])
        cookie = sign_in(service, made["token"])
        admin.revoke_token(made["prefix"])
    known = {"Authorization": None, "Cookie": cookie.split(";")[0]}
    assert problem(service, "GET", "/v1/session", **known)[:2] == (401, "unauthenticated")


def test_answers_forbid_what_a_browser_could_do_with_them(service):
    for path in ("/healthz", "/v1/plants", "/nowhere"):
        headers = request(service, "GET", path)[1]
        assert "default-src 'none'" in headers["content-security-policy"]
        assert "frame-ancestors 'none'" in headers["content-security-policy"]
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"


def test_tokens_are_random():
    assert len({new_token()[0] for _ in range(100)}) == 100


def test_no_file_of_the_service_takes_an_address_or_a_path_from_a_request():
    """Names are never paths, and nothing that a user names is fetched: no module behind the door
    can open an address, load what it is given, or run it. Two ask an address that the settings
    allow."""
    banned = {
        "urllib.request",
        "http.client",
        "httpx2",
        "httpcore2",
        "requests",
        "pickle",
        "marshal",
    }
    allowed = {"openid.py": {"httpx2"}, "webhook_requests.py": {"httpcore2"}}
    banned |= {"importlib", "eval", "exec", "__import__"}
    for path in [*(ROOT / "service").rglob("*.py"), *(ROOT / "worker").rglob("*.py")]:
        used = set()
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                used |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                used |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                used.add(node.func.id)
        assert not used & banned - allowed.get(path.name, set()), path


# -- two people


def test_a_promotion_takes_two_people_where_the_policy_says_so(service, somebody):
    from tests.http.test_http import accepted

    plant = f"p{uuid.uuid4().hex[:8]}"
    with closing(Client(service.url)) as admin:
        admin.register_plant(plant_document(plant))
        decision = accepted(admin, plant, 1.2)
        gate = admin.decision(plant, decision)["gate"]
        with pytest.raises(Problem) as refused:
            admin.declare_policy(
                plant,
                {
                    "schema": "trueup.policy/1",
                    "gate": gate,
                    "approvals": 2,
                    "on_acceptance": "promote",
                },
            )
        assert refused.value.code == "bad-policy"
        admin.declare_policy(plant, {"schema": "trueup.policy/1", "gate": gate, "approvals": 2})
        first, second = (
            admin.issue_token(name, ["operator"])["token"] for name in ("first", "second")
        )
    with (
        closing(Client(service.url, token=first)) as one,
        closing(Client(service.url, token=second)) as other,
    ):
        assert one.approve(plant, decision) == one.approve(plant, decision)
        with pytest.raises(Problem) as refused:
            one.promote(plant, decision, 1)
        assert (refused.value.code, refused.value.facts["needed"]) == ("approval-missing", 2)
        assert other.promote(plant, decision, 1).generation == 2
    with closing(Client(service.url)) as admin:
        entries = list(admin.audit(plant))
    assert next(e for e in entries if e["kind"] == "pointer:moved")["facts"]["approved_by"] == [
        "first"
    ]


def test_a_decision_that_rejects_or_that_nobody_made_is_not_approved(service, tmp_path):
    plant = f"p{uuid.uuid4().hex[:8]}"
    with closing(Client(service.url)) as admin:
        admin.register_plant(plant_document(plant))
        worse = identified(plant, 9.0)
        admin.add_artifact(plant, worse.manifest)
        gate = declare_following(admin, plant, IMPROVING)["digest"]
        recorded = save(tmp_path, "v.mcap", episode_bytes(9, role=Purpose.VALIDATION))
        admin.upload_episode(plant, recorded)
        job = admin.submit(plant, {"kind": "gate", "candidate": worse.digest, "gate": gate})
        made = admin.wait(job["id"])["result"]
        assert not made["accepted"]
        for decision, code in ((made["decision"], "decision-rejected"), ("0" * 64, "not-found")):
            with pytest.raises(Problem) as refused:
                admin.approve(plant, decision)
            assert refused.value.code == code


def test_an_operator_does_not_let_promotions_take_fewer_people(service):
    plant = f"p{uuid.uuid4().hex[:8]}"
    with closing(Client(service.url)) as admin:
        admin.register_plant(plant_document(plant))
        gate = admin.declare_gate(plant)["digest"]
        policy = {"schema": "trueup.policy/1", "gate": gate, "on_acceptance": "ask"}
        admin.declare_policy(plant, policy | {"approvals": 2})
        token = admin.issue_token("alone", ["operator"])["token"]
        with closing(Client(service.url, token=token)) as operator:
            with pytest.raises(Problem) as refused:
                operator.declare_policy(plant, policy | {"approvals": 1})
            assert refused.value.code == "forbidden"
            operator.declare_policy(plant, policy | {"approvals": 3})
        admin.declare_policy(plant, policy | {"approvals": 1})


def test_a_token_of_one_plant_registers_none_and_is_of_a_plant_of_its_project(service, somebody):
    with closing(Client(service.url)) as admin:
        token = admin.issue_token("narrow", ["engineer"], plant=somebody["ours"])["token"]
        with pytest.raises(Problem) as refused:
            admin.issue_token(
                "wrong", ["engineer"], project=somebody["project"], plant=somebody["ours"]
            )
        assert refused.value.code == "not-found"
    with closing(Client(service.url, token=token)) as narrow, pytest.raises(Problem) as refused:
        narrow.register_plant(plant_document(somebody["theirs"]))
    assert (refused.value.code, refused.value.facts) == ("forbidden", {})


def test_a_session_that_was_begun_with_an_old_admins_token_ends_with_it(tmp_path):
    parts = build(Settings(data_dir=tmp_path, admin_token="a" * 40))
    old, new = (
        Authenticator(
            Settings(data_dir=tmp_path, admin_token=c * 40, token_memory_s=0), parts.database
        )
        for c in "ab"
    )
    from trueup_service.authentication import digest_of_secret
    from trueup_service.registry.transaction import writing

    with writing(parts.database) as tx:
        tx.sessions.begin(digest_of_secret("cookie"), old.by_token("a" * 40).token, "2026", "9999")
    assert old.by_session("cookie").name == "admin"
    with pytest.raises(Unauthenticated):
        new.by_session("cookie")
    parts.close()
