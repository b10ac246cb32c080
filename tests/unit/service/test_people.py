"""Who is behind a token that this registry has never issued."""

from trueup_service.actions.people import person_of
from trueup_service.actions.tokens import issue_token, revoke_token
from trueup_service.actor_context import ActorContext
from trueup_service.registry.records import TokenRecord
from trueup_service.registry.transaction import writing
from trueup_service.settings import Settings
from trueup_service.wiring import build


def test_the_token_of_another_site_is_its_actors_and_not_the_admins(tmp_path):
    parts = build(Settings(data_dir=tmp_path))
    context = ActorContext("admin", "2026-01-01T00:00:00.000000Z")
    with writing(parts.database) as tx:
        issue_token(
            tx,
            TokenRecord(
                "here", "0" * 64, "Shopper ", ["operator"], None, None, context.now, "admin", None
            ),
            context,
        )
        assert (
            person_of(tx, "elsewhere", "shopper for Ana")
            == person_of(tx, "here", "whoever")
            == "shopper"
        )
        assert person_of(tx, "of the settings", "admin") == "admin"
        revoke_token(tx, "here", context)
        assert person_of(tx, "here", "whoever") is None
    parts.close()
