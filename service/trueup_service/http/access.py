"""Access rules: one row for each route. A route without a row is refused to everybody, and a test
fails.

An admin may do everything. A token of a project sees the plants of that project alone, and a token
of a plant that plant alone. What it does not see gets the response of what does not exist. A route
marked `everywhere` shows the whole registry, and needs a token of all projects.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from trueup_service.registry.records import Role

ROBOT, ENGINEER, OPERATOR, AUDITOR, ADMIN = (
    Role.ROBOT,
    Role.ENGINEER,
    Role.OPERATOR,
    Role.AUDITOR,
    Role.ADMIN,
)


@dataclass(frozen=True, slots=True)
class Rule:
    """Which roles may use a route, besides an admin. `public` is for everybody, and `everywhere`
    needs a token of all projects."""

    roles: frozenset[Role] = frozenset()
    public: bool = False
    everywhere: bool = False


def _of(*roles: Role, everywhere: bool = False) -> Rule:
    return Rule(frozenset({*roles, ADMIN}), everywhere=everywhere)


PUBLIC = Rule(public=True)
ANYBODY = _of(ROBOT, ENGINEER, OPERATOR, AUDITOR)
READERS = _of(ENGINEER, OPERATOR, AUDITOR)
SENDERS = _of(ROBOT, ENGINEER)
ENGINEERS = _of(ENGINEER)
OPERATORS = _of(OPERATOR)
ENGINEERS_AND_OPERATORS = _of(ENGINEER, OPERATOR)
AUDITORS = _of(AUDITOR)
WHOLE = _of(AUDITOR, everywhere=True)
ADMINS = _of(everywhere=True)

PLANT = "/v1/plants/{plant}"
ACCESS: Mapping[tuple[str, str], Rule] = {
    ("GET", "/healthz"): PUBLIC,
    ("GET", "/readyz"): PUBLIC,
    ("GET", "/metrics"): _of(OPERATOR, AUDITOR, everywhere=True),
    ("POST", "/v1/session"): PUBLIC,
    ("GET", "/v1/session"): ANYBODY,
    ("DELETE", "/v1/session"): ANYBODY,
    ("POST", "/v1/plants"): ENGINEERS,
    ("GET", "/v1/plants"): READERS,
    ("GET", PLANT): ANYBODY,
    ("GET", f"{PLANT}/labels"): READERS,
    ("GET", f"{PLANT}/labels/{{kind}}/{{subject}}"): READERS,
    ("PATCH", f"{PLANT}/labels/{{kind}}/{{subject}}"): ENGINEERS_AND_OPERATORS,
    ("POST", "/v1/drafts"): ENGINEERS,
    ("GET", "/v1/drafts/{draft}"): ENGINEERS,
    ("POST", "/v1/drafts/{draft}/revise"): ENGINEERS,
    ("POST", "/v1/drafts/{draft}/register"): ENGINEERS,
    ("POST", f"{PLANT}/episodes"): SENDERS,
    ("GET", f"{PLANT}/episodes"): READERS,
    ("GET", f"{PLANT}/episodes/{{digest}}"): READERS,
    ("GET", f"{PLANT}/episodes/{{digest}}/content"): READERS,
    ("DELETE", f"{PLANT}/episodes/{{digest}}"): ENGINEERS,
    ("GET", f"{PLANT}/uploads/{{digest}}"): SENDERS,
    ("PATCH", f"{PLANT}/uploads/{{digest}}"): SENDERS,
    ("POST", f"{PLANT}/uploads/{{digest}}/finish"): SENDERS,
    ("POST", f"{PLANT}/telemetry"): SENDERS,
    ("PUT", "/v1/blobs/{digest}"): ENGINEERS,
    ("GET", "/v1/blobs/{digest}"): WHOLE,
    ("POST", f"{PLANT}/artifacts"): ENGINEERS,
    ("GET", f"{PLANT}/artifacts"): READERS,
    ("GET", f"{PLANT}/artifacts/{{digest}}"): ANYBODY,
    ("GET", f"{PLANT}/artifacts/{{digest}}/manifest"): ANYBODY,
    ("GET", f"{PLANT}/artifacts/{{digest}}/arrays"): ANYBODY,
    ("GET", f"{PLANT}/artifacts/{{digest}}/provenance"): ANYBODY,
    ("GET", f"{PLANT}/artifacts/{{digest}}/evidence"): READERS,
    ("GET", f"{PLANT}/artifacts/{{digest}}/membership"): READERS,
    ("DELETE", f"{PLANT}/artifacts/{{digest}}"): ENGINEERS,
    ("GET", f"{PLANT}/versions/{{version}}"): READERS,
    ("POST", f"{PLANT}/gates"): ENGINEERS,
    ("GET", f"{PLANT}/gates"): READERS,
    ("GET", f"{PLANT}/gates/{{digest}}"): READERS,
    ("GET", f"{PLANT}/gates/{{digest}}/line"): READERS,
    ("GET", f"{PLANT}/gate"): READERS,
    ("POST", f"{PLANT}/jobs"): ENGINEERS,
    ("GET", f"{PLANT}/jobs"): READERS,
    ("GET", "/v1/jobs"): READERS,
    ("GET", "/v1/jobs/{job}"): READERS,
    ("GET", "/v1/jobs/{job}/outputs/{name}"): READERS,
    ("POST", "/v1/jobs/{job}/cancel"): ENGINEERS,
    ("GET", f"{PLANT}/decisions"): READERS,
    ("GET", f"{PLANT}/decisions/{{digest}}"): READERS,
    ("GET", f"{PLANT}/decisions/{{digest}}/provenance"): ANYBODY,
    ("POST", f"{PLANT}/decisions/{{digest}}/approvals"): OPERATORS,
    ("GET", f"{PLANT}/decisions/{{digest}}/approvals"): READERS,
    ("GET", "/v1/decisions/{digest}"): READERS,
    ("GET", f"{PLANT}/serving"): ANYBODY,
    ("GET", f"{PLANT}/serving/envelope"): ANYBODY,
    ("GET", f"{PLANT}/serving/history"): READERS,
    ("POST", f"{PLANT}/serving/promote"): OPERATORS,
    ("POST", f"{PLANT}/serving/rollback"): OPERATORS,
    ("GET", f"{PLANT}/monitor"): READERS,
    ("GET", f"{PLANT}/monitors"): READERS,
    ("GET", f"{PLANT}/monitors/{{digest}}"): READERS,
    ("GET", f"{PLANT}/monitors/{{digest}}/watches"): READERS,
    ("GET", f"{PLANT}/alarms"): READERS,
    ("GET", f"{PLANT}/alarms/{{alarm}}"): READERS,
    ("POST", f"{PLANT}/alarms/{{alarm}}/close"): ENGINEERS_AND_OPERATORS,
    ("POST", f"{PLANT}/policies"): OPERATORS,
    ("GET", f"{PLANT}/policies"): READERS,
    ("GET", f"{PLANT}/policy"): READERS,
    ("POST", f"{PLANT}/evidence"): ENGINEERS,
    ("POST", f"{PLANT}/channels"): OPERATORS,
    ("GET", f"{PLANT}/channels"): READERS,
    ("GET", f"{PLANT}/channels/{{channel}}/serving"): ANYBODY,
    ("POST", f"{PLANT}/channels/{{channel}}/move"): OPERATORS,
    ("GET", "/v1/audit"): AUDITORS,
    ("GET", "/v1/audit/key"): ANYBODY,
    ("GET", "/v1/audit/keys"): ANYBODY,
    ("GET", "/v1/audit/checkpoint"): ANYBODY,
    ("GET", "/v1/audit/inclusion"): ANYBODY,
    ("GET", "/v1/audit/consistency"): ANYBODY,
    ("GET", "/v1/audit/tile/entries/{tile:path}"): WHOLE,
    ("GET", "/v1/audit/tile/{level}/{tile:path}"): ANYBODY,
    ("GET", "/v1/audit/rows/{table}"): WHOLE,
    ("GET", "/sign-in"): PUBLIC,
    ("POST", "/sign-in"): PUBLIC,
    ("GET", "/sign-in/openid"): PUBLIC,
    ("GET", "/sign-in/openid/callback"): PUBLIC,
    ("POST", "/sign-out"): ANYBODY,
    ("GET", "/static/{name}"): PUBLIC,
    ("GET", "/"): READERS,
    ("GET", "/new"): ENGINEERS,
    ("GET", "/new/{draft}"): ENGINEERS,
    ("POST", "/new/{draft}"): ENGINEERS,
    ("GET", "/plants/{plant}"): READERS,
    ("POST", "/plants/{plant}/diagnoses"): ENGINEERS,
    ("GET", "/plants/{plant}/diagnoses/{job}"): READERS,
    ("GET", "/plants/{plant}/diagnoses/{job}/report.html"): READERS,
    ("POST", "/plants/{plant}/studies/{kind}"): ENGINEERS,
    ("GET", "/plants/{plant}/studies/{job}"): READERS,
    ("GET", "/plants/{plant}/studies/{job}/report.html"): READERS,
    ("GET", "/live"): READERS,
    ("GET", "/jobs"): READERS,
    ("GET", "/plants/{plant}/jobs"): READERS,
    ("POST", "/plants/{plant}/jobs"): ENGINEERS,
    ("GET", "/plants/{plant}/jobs/{job}"): READERS,
    ("POST", "/plants/{plant}/jobs/{job}/cancel"): ENGINEERS,
    ("GET", "/plants/{plant}/upload"): ENGINEERS,
    ("GET", "/plants/{plant}/gate"): READERS,
    ("POST", "/plants/{plant}/gate"): ENGINEERS,
    ("GET", "/plants/{plant}/excite"): READERS,
    ("POST", "/plants/{plant}/excite"): ENGINEERS,
    ("GET", "/plants/{plant}/policy"): READERS,
    ("POST", "/plants/{plant}/policy"): OPERATORS,
    ("GET", "/plants/{plant}/monitor"): READERS,
    ("POST", "/plants/{plant}/alarms/{alarm}/close"): ENGINEERS_AND_OPERATORS,
    ("GET", "/plants/{plant}/channels"): READERS,
    ("POST", "/plants/{plant}/channels"): OPERATORS,
    ("POST", "/plants/{plant}/channels/{channel}/move"): OPERATORS,
    ("GET", "/plants/{plant}/rollback"): OPERATORS,
    ("POST", "/plants/{plant}/rollback"): OPERATORS,
    ("GET", "/plants/{plant}/decisions/{digest}"): READERS,
    ("POST", "/plants/{plant}/decisions/{digest}/recompute"): READERS,
    ("POST", "/plants/{plant}/decisions/{digest}/promote"): OPERATORS,
    ("POST", "/plants/{plant}/decisions/{digest}/approve"): OPERATORS,
    ("GET", "/plants/{plant}/episodes"): READERS,
    ("GET", "/plants/{plant}/versions"): READERS,
    ("GET", "/plants/{plant}/versions/{version}"): READERS,
    ("GET", "/plants/{plant}/decisions"): READERS,
    ("POST", "/plants/{plant}/labels/{kind}/{subject}"): ENGINEERS_AND_OPERATORS,
    ("GET", "/plants/{plant}/episodes/{digest}"): READERS,
    ("POST", "/plants/{plant}/episodes/{digest}/signals"): ENGINEERS,
    ("GET", "/plants/{plant}/foxglove.json"): READERS,
    ("GET", "/plants/{plant}/compare"): READERS,
    ("POST", "/plants/{plant}/compare"): ENGINEERS,
    ("GET", "/audit"): AUDITORS,
    ("POST", "/audit/compare"): AUDITORS,
    ("POST", "/v1/webhooks"): ADMINS,
    ("GET", "/v1/webhooks"): ADMINS,
    ("GET", "/v1/webhooks/{webhook}"): ADMINS,
    ("POST", "/v1/webhooks/{webhook}/test"): ADMINS,
    ("POST", "/v1/webhooks/{webhook}/resume"): ADMINS,
    ("POST", "/v1/webhooks/{webhook}/remove"): ADMINS,
    ("POST", "/v1/projects"): ADMINS,
    ("GET", "/v1/projects"): ADMINS,
    ("POST", "/v1/tokens"): ADMINS,
    ("GET", "/v1/tokens"): ADMINS,
    ("POST", "/v1/tokens/{prefix}/revoke"): ADMINS,
}
