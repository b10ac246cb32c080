"""Signing in at an OpenID provider: the authorization code flow with PKCE, and what somebody's
groups allow.

What a browser needs between leaving for the provider and coming back (state, nonce, code verifier)
is kept in a cookie of its own, out of reach of scripts, so that any server process can take it up.
Source: OpenID Connect Core 1.0, section 3.1; OpenID Connect Discovery 1.0, section 4.3; RFC 7636;
RFC 9700, section 2.1.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from fastapi import Request, Response

from trueup.errors import NotInstalled
from trueup_service.control_characters import control_character
from trueup_service.errors import Forbidden, ProviderAway, SignInRefused
from trueup_service.settings import GroupGrant, Settings

FLOW_COOKIE, FLOW_S = "trueup_openid", 600  # in which somebody signs in at the provider
PATH = "/sign-in/openid"
DISCOVERY = "/.well-known/openid-configuration"
TIMEOUT_S = 10.0
VERIFIED = (True, "true")  # some providers write text
LONGEST_NAME = 100  # characters, as of a token
# of algorithms, those by which a key that only the provider has signs
SIGNED = ("RS", "PS", "ES", "Ed")


@dataclass(frozen=True, slots=True)
class Person:
    """Somebody whom the provider knows: the name in the log, roles, and the project, None for
    all."""

    name: str
    roles: tuple[str, ...]
    project: str | None


@dataclass(frozen=True, slots=True)
class Arrival:
    """Who came back from the provider: a person of all projects, and one for each project in which
    their groups allow more; the project that was chosen, empty for all, None where none was; and
    where the browser wanted to be."""

    people: tuple[Person, ...]
    to: str
    project: str | None


class OpenIdProvider:
    """The provider of the settings. Raises NotInstalled."""

    def __init__(self, settings: Settings) -> None:
        try:
            from authlib.integrations.starlette_client import OAuth  # noqa: PLC0415
        except ImportError as error:
            raise NotInstalled(
                "signing in at an OpenID provider needs Authlib and httpx2",
                hint="Install them with `pip install 'trueup-service[openid]'`, or unset "
                "TRUEUP_OPENID_ISSUER.",
            ) from error
        secret = settings.openid_client_secret
        self._settings = settings
        self._issuer = str(settings.openid_issuer).rstrip("/")
        self._client: Any = OAuth().register(
            name="openid",
            client_id=settings.openid_client_id,
            client_secret=secret.get_secret_value() if secret else None,
            server_metadata_url=self._issuer + DISCOVERY,
            client_kwargs={
                "scope": settings.openid_scope,
                "code_challenge_method": "S256",
                "token_endpoint_auth_method": "client_secret_basic" if secret else "none",
                "timeout": TIMEOUT_S,
            },
        )

    async def leave(self, request: Request, origin: str, to: str, project: str | None) -> Response:
        """Send a browser to the provider, and remember where it wanted to be. Raises
        ProviderAway."""
        flow: dict[str, Any] = {"to": to, "project": project}
        request.scope["session"] = flow
        with _answering():
            await self._require_metadata()
            response: Response = await self._client.authorize_redirect(
                request, f"{origin}{PATH}/callback"
            )
        response.set_cookie(
            FLOW_COOKIE,
            base64.urlsafe_b64encode(json.dumps(flow).encode()).decode(),
            max_age=FLOW_S,
            path=PATH,
            httponly=True,
            samesite="lax",  # the browser comes back from another site
            secure=origin.startswith("https:"),
        )
        return response

    async def arrive(self, request: Request) -> Arrival:
        """Who comes back from the provider. Raises ProviderAway, SignInRefused, Forbidden."""
        flow = _flow(request)
        request.scope["session"] = flow
        with _answering():
            metadata = await self._require_metadata()
            token = await self._client.authorize_access_token(
                request,
                claims_options={
                    "iss": {"essential": True, "values": [metadata["issuer"]]},
                    "aud": {"essential": True, "value": self._settings.openid_client_id},
                    "exp": {"essential": True},
                },
            )
            claims = dict(token.get("userinfo") or {})
            if not claims:
                raise SignInRefused("the provider's answer has no ID token")
            if not self._is_complete(claims) and "userinfo_endpoint" in metadata:
                more = await self._client.userinfo(token=token)
                if more.get("sub") != claims["sub"]:
                    raise SignInRefused("userinfo is of another person than the ID token")
                claims = {**more, **claims}
        people = people_of(claims, self._settings)
        return Arrival(people, str(flow.get("to", "/")), flow.get("project"))

    def _is_complete(self, claims: Mapping[str, Any]) -> bool:
        needed = self._settings.openid_groups_claim, self._settings.openid_name_claim
        return all(name in claims for name in needed)

    async def _require_metadata(self) -> Mapping[str, Any]:
        metadata: dict[str, Any] = await self._client.load_server_metadata()
        if str(metadata.get("issuer", "")).rstrip("/") != self._issuer:
            raise ProviderAway(
                f"the provider calls itself {metadata.get('issuer')!r}, not {self._issuer!r}"
            )
        algorithms = metadata.get("id_token_signing_alg_values_supported") or ["RS256"]
        metadata["id_token_signing_alg_values_supported"] = [
            a for a in algorithms if a.startswith(SIGNED)
        ]
        return metadata


def people_of(claims: Mapping[str, Any], settings: Settings) -> tuple[Person, ...]:
    """What somebody with these claims may be: of all projects, then one for each project in which
    they may do more. Raises SignInRefused, Forbidden."""
    name = claims.get(settings.openid_name_claim)
    if not isinstance(name, str) or not 0 < len(name) <= LONGEST_NAME or control_character(name):
        raise SignInRefused(
            f"the provider gives no name in the claim {settings.openid_name_claim!r}",
            hint="Whoever runs the service chooses another claim in TRUEUP_OPENID_NAME_CLAIM, or "
            "asks for more in TRUEUP_OPENID_SCOPE.",
        )
    if settings.openid_name_claim == "email" and claims.get("email_verified") not in VERIFIED:
        raise SignInRefused(
            f"the provider has not verified the address {name}",
            hint="Verify the address at the provider; where the provider verifies none, whoever "
            "runs the service chooses another claim in TRUEUP_OPENID_NAME_CLAIM.",
        )
    groups = _groups(claims.get(settings.openid_groups_claim))
    grants = [settings.openid_groups[g] for g in groups if g in settings.openid_groups]
    if not grants:
        raise Forbidden(
            f"{name} is in no group that may sign in here",
            hint="Ask whoever runs the service to name one of your groups in TRUEUP_OPENID_GROUPS.",
            groups=groups,
        )
    everywhere = _roles(grants, None)
    projects = sorted({g.project for g in grants if g.project is not None})
    within = [Person(name, _roles(grants, project), project) for project in projects]
    whole = [Person(name, everywhere, None)] if everywhere else []
    # a project in which somebody may do no more than in all is none to choose
    return (*whole, *(p for p in within if p.roles != everywhere))


def _groups(claim: Any) -> list[str]:
    """The groups of a claim: a list, or one group as text."""
    if isinstance(claim, str):
        return [claim]
    return [str(g) for g in claim] if isinstance(claim, list) else []


def _roles(grants: Sequence[GroupGrant], project: str | None) -> tuple[str, ...]:
    """The roles in a project, those of all projects among them, in the order in which roles are
    listed."""
    held = {role for g in grants if g.project in (None, project) for role in g.roles}
    return tuple(r for r in ("engineer", "operator", "auditor", "admin") if r in held)


def _flow(request: Request) -> dict[str, Any]:
    """What was remembered when the browser left. Raises SignInRefused."""
    cookie = request.cookies.get(FLOW_COOKIE, "")
    try:
        flow = json.loads(base64.urlsafe_b64decode(cookie))
    except ValueError:
        flow = None
    if not isinstance(flow, dict):
        raise SignInRefused("no sign-in is under way in this browser, or it took too long")
    return flow


@contextmanager
def _answering() -> Iterator[None]:
    """Turns what Authlib, joserfc and httpx2 raise in the block into errors of ours."""
    import httpx2  # noqa: PLC0415
    from authlib.common.errors import AuthlibBaseError  # noqa: PLC0415
    from joserfc.errors import JoseError  # noqa: PLC0415

    try:
        yield
    except httpx2.HTTPError as error:
        words = str(error) or type(error).__name__
        raise ProviderAway(f"the OpenID provider does not answer: {words}") from error
    except (AuthlibBaseError, JoseError) as error:
        words = getattr(error, "description", "") or str(error)
        raise SignInRefused(f"the sign-in was refused: {words}") from error
    except (KeyError, ValueError, RuntimeError) as error:
        raise ProviderAway(f"the OpenID provider's answer cannot be read: {error}") from error
