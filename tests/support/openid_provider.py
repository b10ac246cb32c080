"""An OpenID provider for tests: Django OAuth Toolkit, in a process of its own.

It asks for a password, requires PKCE, checks redirect addresses and signs with RS256. Run as a
program it serves until its standard input closes, and prints its address first.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

CLIENT, SECRET, PASSWORD = "trueup-tests", "a-secret-of-the-tests", "correct horse"
LOGIN = """<form method="post">{% csrf_token %}{{ form }}<button>Log in</button></form>"""


@contextmanager
def providing(
    folder: Path, redirect_uris: Sequence[str], people: Mapping[str, Mapping[str, Any]]
) -> Iterator[str]:
    """Runs a provider that knows these people, by user name, with these claims. Yields its
    address."""
    settings = {"folder": str(folder), "redirect_uris": list(redirect_uris), "people": people}
    with subprocess.Popen(
        [sys.executable, "-W", "ignore", str(Path(__file__)), json.dumps(settings)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "OAUTHLIB_INSECURE_TRANSPORT": "1"},
    ) as process:
        assert process.stdout is not None
        assert process.stdin is not None
        yield process.stdout.readline().strip()
        process.stdin.close()
        process.wait(timeout=10)


def _main() -> None:
    from cryptography.hazmat.primitives import serialization
    from cryptography.hazmat.primitives.asymmetric import rsa

    given = json.loads(sys.argv[1])
    key = rsa.generate_private_key(public_exponent=65537, key_size=2048)
    pem = key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    ).decode()
    _configure(Path(given["folder"]), pem)

    import django

    django.setup()
    from django.contrib.auth.models import User
    from django.core.management import call_command
    from django.core.wsgi import get_wsgi_application
    from oauth2_provider.models import get_application_model
    from werkzeug.serving import make_server

    call_command("migrate", verbosity=0)
    for name in given["people"]:
        User.objects.create_user(name, password=PASSWORD)
    get_application_model().objects.create(
        client_id=CLIENT,
        client_secret=SECRET,
        client_type="confidential",
        authorization_grant_type="authorization-code",
        redirect_uris=" ".join(given["redirect_uris"]),
        algorithm="RS256",
        skip_authorization=True,
        name="trueup",
    )
    _Claims.people = given["people"]
    server = make_server("127.0.0.1", 0, get_wsgi_application(), threaded=True)
    print(f"http://127.0.0.1:{server.port}/o", flush=True)
    import threading

    threading.Thread(target=server.serve_forever, daemon=True).start()
    sys.stdin.read()
    os._exit(0)


def _configure(folder: Path, key: str) -> None:
    from django.conf import settings

    settings.configure(
        DEBUG=False,
        SECRET_KEY="of the tests",
        ALLOWED_HOSTS=["127.0.0.1"],
        ROOT_URLCONF="openid_urls",
        DATABASES={
            "default": {
                "ENGINE": "django.db.backends.sqlite3",
                "NAME": str(folder / "provider.sqlite"),
            }
        },
        INSTALLED_APPS=[
            "django.contrib.auth",
            "django.contrib.contenttypes",
            "django.contrib.sessions",
            "oauth2_provider",
        ],
        MIDDLEWARE=[
            "django.contrib.sessions.middleware.SessionMiddleware",
            "django.middleware.csrf.CsrfViewMiddleware",
            "django.contrib.auth.middleware.AuthenticationMiddleware",
        ],
        TEMPLATES=[
            {
                "BACKEND": "django.template.backends.django.DjangoTemplates",
                "OPTIONS": {
                    "loaders": [
                        (
                            "django.template.loaders.locmem.Loader",
                            {"registration/login.html": LOGIN},
                        )
                    ],
                },
            }
        ],
        LOGIN_URL="/login/",
        PASSWORD_HASHERS=["django.contrib.auth.hashers.MD5PasswordHasher"],
        DEFAULT_AUTO_FIELD="django.db.models.AutoField",
        USE_TZ=True,
        OAUTH2_PROVIDER={
            "OIDC_ENABLED": True,
            "OIDC_RSA_PRIVATE_KEY": key,
            "PKCE_REQUIRED": True,
            "SCOPES": {"openid": "", "profile": "", "email": ""},
            "OAUTH2_VALIDATOR_CLASS": _validator(),
        },
    )
    sys.modules["openid_urls"] = _urls()


class _Claims:
    people: Mapping[str, Mapping[str, Any]] = {}


def _validator() -> Any:
    # named by the module that runs, since its base needs the settings that name it
    module = type(sys)("openid_validator")

    def load(name: str) -> Any:
        from oauth2_provider.oauth2_validators import OAuth2Validator

        class Validator(OAuth2Validator):
            oidc_claim_scope = None

            def get_additional_claims(self, request: Any) -> dict[str, Any]:
                return dict(_Claims.people[request.user.username])

        if name == "Validator":
            return Validator
        raise AttributeError(name)

    module.__getattr__ = load  # type: ignore[method-assign]
    sys.modules["openid_validator"] = module
    return "openid_validator.Validator"


def _urls() -> Any:
    module = type(sys)("openid_urls")

    def load(name: str) -> Any:
        from django.contrib.auth.views import LoginView
        from django.urls import include, path

        if name != "urlpatterns":
            raise AttributeError(name)
        return [
            path("login/", LoginView.as_view()),
            path("o/", include("oauth2_provider.urls", namespace="oauth2_provider")),
        ]

    module.__getattr__ = load  # type: ignore[method-assign]
    return module


if __name__ == "__main__":
    _main()
