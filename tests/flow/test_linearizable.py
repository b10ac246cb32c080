"""The serving pointer is one register, whichever of two servers is asked."""

from contextlib import closing

from tests.support.linearizable import Operation, prepare, run, violations
from tests.support.service import ADMIN, Service
from tests.support.storage import Storage, scaled
from trueup.ledger.verification import verify
from trueup_client import Client
from trueup_service.installation import Installation


def test_the_pointer_is_one_register_over_two_servers(postgres, s3, tmp_path):
    storage = scaled(tmp_path / "a", postgres, s3)
    servers = [
        Service(storage),
        Service(Storage("scaled", storage.environment | {"TRUEUP_DATA_DIR": str(tmp_path / "b")})),
    ]
    parts = storage.build()
    try:
        for server in servers:
            server.start_server()
        with closing(Client(servers[0].url)) as client:
            decisions = prepare(parts, client, "p", tmp_path, 60)
            found = run([s.url for s in servers], ADMIN, "p", decisions, 6, 30, 1)
            told = list(client.history("p"))
        assert violations(found, told) == []
        assert len(told) > 5
        moves = {o.generation for o in found if o.kind != "read" and o.generation}
        assert moves == {s.generation for s in told[1:]}  # every move was acknowledged once
        assert {o.kind for o in found if o.generation} == {"read", "promote", "rollback"}
        assert verify(Installation(parts.database, parts.blobs)).findings == []
    finally:
        parts.close()
        for server in servers:
            server.stop()


def test_what_no_register_does_is_seen():
    served = type("Served", (), {})
    told = []
    for generation, artifact in ((1, "a"), (2, "b"), (3, "a")):
        position = served()
        position.generation, position.artifact = generation, artifact
        told.append(position)
    fine = [
        Operation("read", 0, 1, 1, "a"),
        Operation("promote", 0.5, 2, 2, "b"),
        Operation("read", 1.5, 3, 1, "a"),
    ]
    assert violations(fine, told) == []
    # an old answer after the move was acknowledged
    (said,) = violations([*fine, Operation("read", 2.5, 4, 1, "a")], told)
    assert said == "a read showed generation 1 after 2 had been shown"
    # two moves took one generation
    assert "generation 2 was taken twice" in violations(
        [*fine, Operation("rollback", 2.1, 4, 2, "b")], told
    )
    # a position that the log does not tell of
    said = violations([*fine, Operation("read", 2.1, 4, 2, "a")], told)
    assert said == ["generation 2 was shown as a"]
