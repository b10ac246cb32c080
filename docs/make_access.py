"""Write access.md from the matrix that the service enforces."""

from pathlib import Path

from trueup_service.http.access import ACCESS
from trueup_service.registry.records import Role

HEAD = """# Who may do what

Every request but those marked *everybody* carries a token (`Authorization: Bearer trueup_…`), or a
browser's session cookie. A token has one or several roles, and is of one project or of all, a
robot's of one plant. If a token may not see something, the service answers as if it did not exist.
The service refuses every route that is not in the table below, except `/openapi.json`, which
everybody may read. The tests check each row against the running service.

| role | is for |
|---|---|
| robot | one machine: upload its own episodes and telemetry, read what it is to use |
| engineer | register, upload, fit, diagnose, judge |
| operator | promote, roll back, release, declare what may happen without a person |
| auditor | read everything, verify the log |
| admin | everything, tokens and projects among it |

```
trueup token issue cell-7 robot --plant emps            # printed once; the robot's TRUEUP_TOKEN
trueup token issue ada engineer operator --project lab
trueup token revoke 0123456789ab
trueup login                           # keep a token for an address; trueup whoami says whose it is
```

On its first start a service listens on loopback alone and makes an admin's token in
`.trueup/admin.token`, which the command reads when it asks a service on this machine. Tokens are
random, kept as hashes, found by their public prefix (the twelve digits), compared in constant time;
they expire, by default after a year, and can be revoked. Another server of the same database
refuses a revoked token within `TRUEUP_TOKEN_MEMORY_S`.

**People may sign in at an OpenID provider** instead of with a token: Keycloak, Entra ID, Okta,
Google, or what else speaks OpenID Connect (`pip install 'trueup-service[openid]'`; the images have
it). Register trueup there as a web application with the redirect address
`https://YOUR-HOST/sign-in/openid/callback`, then say what each group may do:

```
export TRUEUP_PUBLIC_URL=https://registry.example.com
export TRUEUP_OPENID_ISSUER=https://accounts.example.com/realms/lab
export TRUEUP_OPENID_CLIENT_ID=trueup TRUEUP_OPENID_CLIENT_SECRET=…
export TRUEUP_OPENID_GROUPS='{"lab": {"roles": ["engineer"]}, "ops": {"roles": ["operator"]}}'
```

A group applies to one project (`"project": "cell-7"`) or to all projects. A session also applies to
all projects or to one. In a session of one project a person also holds the roles that they have in
all projects. If a person's roles differ between projects, they choose the project when they sign
in. The log names people by the claim in `TRUEUP_OPENID_NAME_CLAIM`. Choose a claim that people
cannot
set for themselves; an email is accepted only if the provider marks it as verified. A token with the
same name counts as the same person, also in approvals by two people. A session
lasts `TRUEUP_SESSION_S`, and a group that somebody leaves counts until then; `trueup token list`
shows the token that stands for the session, and revoking it ends the session at once. Without a
provider nothing changes, and with one tokens go on: robots and pipelines have no browser.

Where a plant's policy says `"approvals": 2`, a promotion takes two people: one approves the
decision (`trueup approve`), another, with another token, promotes it. Going back takes one person.

"""


def page() -> str:
    """The page."""
    roles = list(Role)
    rows = ["| route | " + " | ".join(roles) + " |", "|---|" + "---|" * len(roles)]
    for (method, path), rule in ACCESS.items():
        marks = [
            "everybody"
            if rule.public
            else ("all projects" if rule.everywhere else "yes")
            if role in rule.roles
            else ""
            for role in roles
        ]
        rows.append(f"| `{method} {path}` | " + " | ".join(marks) + " |")
    return HEAD + "\n".join(rows) + "\n"


if __name__ == "__main__":
    (Path(__file__).parent / "access.md").write_text(page())
