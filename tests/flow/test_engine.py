"""The job engine never unpickles: a row that says so runs nothing, and the worker goes on."""

import base64
import os
import pickle
import subprocess
import sys
import uuid
from contextlib import closing
from pathlib import Path

import pytest
from sqlalchemy import inspect, text

from tests.flow.test_failures import until
from tests.support.made import episode_bytes, plant_document, save
from tests.support.service import Service
from tests.support.storage import SIGNING_KEY, embedded
from trueup.episode.role import Role
from trueup.ledger.signed_note import Signer
from trueup_client import Client
from trueup_service import engine as _shut  # noqa: F401  (as whatever uses the engine does)
from trueup_service.errors import Pickled
from trueup_service.jobs import QUEUE, WORKFLOW, migrate_engine
from trueup_service.registry.database import Database

READ = [  # every column that the engine deserializes
    ("workflow_status", "inputs"), ("workflow_status", "output"), ("workflow_status", "error"),
    ("operation_outputs", "output"), ("operation_outputs", "error"), ("notifications", "message"),
    ("workflow_events", "value"), ("streams", "value"), ("workflow_schedules", "context"),
]  # fmt: skip


class Payload:
    """Makes a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __reduce__(self):
        return Path.touch, (self._path,)


def planted(path: Path) -> str:
    return base64.b64encode(pickle.dumps(Payload(path))).decode()


def test_the_payload_runs_where_the_engine_is_as_it_comes(tmp_path):
    """A control: were nothing shut, this is what a row would do."""
    code = (
        "import sys; from dbos._serialization import DBOSPortableJSON, deserialize_args; "
        "deserialize_args(sys.argv[1], 'py_pickle', DBOSPortableJSON)"
    )
    subprocess.run(
        [sys.executable, "-c", code, planted(tmp_path / "ran")],
        check=True,
        env={**os.environ, "PYTHONWARNINGS": "ignore"},
    )
    assert (tmp_path / "ran").exists()


def test_no_function_by_which_the_engine_reads_a_column_unpickles(tmp_path):
    from dbos import _serialization as engine

    ran = tmp_path / "ran"
    for read in (engine.deserialize_args, engine.deserialize_value, engine.deserialize_exception):
        with pytest.raises(Pickled):
            read(planted(ran), "py_pickle", engine.DBOSPortableJSON)
    with pytest.raises(Pickled):
        engine.DefaultSerializer().deserialize(planted(ran))
    assert not ran.exists()


def test_the_engine_reads_no_other_columns(tmp_path):
    """Whoever updates the engine finds here a column that is read and was not planted into."""
    database = Database(f"sqlite:///{tmp_path / 'x.sqlite'}", 2)
    migrate_engine(f"sqlite:///{tmp_path / 'x.sqlite'}")
    found = inspect(database.engine)
    serialized = {
        table
        for table in found.get_table_names()
        if "serialization" in {c["name"] for c in found.get_columns(table)}
    }
    assert serialized - {"workflow_events_history"} == {table for table, _ in READ} - {
        "workflow_schedules"
    }
    columns = {(t, c["name"]) for t, _ in READ for c in found.get_columns(t)}
    assert set(READ) <= columns
    database.close()


def test_a_planted_row_in_any_column_runs_nothing_in_a_worker_that_goes_on(storage, tmp_path):
    ran = tmp_path / "ran"
    with Service(storage).running(worker=False) as service, closing(Client(service.url)) as client:
        client.register_plant(plant_document("p"))
        client.upload_episode("p", save(tmp_path, "0.mcap", episode_bytes(0, role=Role.ADAPTATION)))
        victim = client.submit("p", {"kind": "fit", "method": "identify"})["id"]
        with closing(storage.build()) as parts:
            plant_rows(parts.database, ran, victim)
        service.start_worker()
        sound = client.submit("p", {"kind": "fit", "method": "residual"})["id"]
        assert client.wait(sound)["state"] == "succeeded"
        taken = until(lambda: no_longer_queued(storage))
        assert victim in taken
        assert len(taken) == 3  # with the one that nobody asked for
        assert not ran.exists()


def no_longer_queued(storage) -> list[str]:
    """The jobs of the engine once its worker has taken all of them; none before."""
    with closing(storage.build()) as parts, parts.database.read() as connection:
        table = "workflow_status" if parts.database.is_sqlite else "dbos.workflow_status"
        rows = connection.execute(
            text(f"SELECT workflow_uuid, status FROM {table} WHERE name = :name"),
            {"name": WORKFLOW},
        ).all()
    return [] if any(row.status == "ENQUEUED" for row in rows) else [r.workflow_uuid for r in rows]


def plant_rows(database: Database, ran: Path, victim: str) -> None:
    """Plant the payload into every column that is read, of a queued job, of one that is done, and
    of one that nobody asked for."""
    found, schema = inspect(database.engine), None if database.is_sqlite else "dbos"
    prefix = "" if schema is None else f"{schema}."
    with database.write() as connection:
        pickled = {"payload": planted(ran), "id": victim}
        connection.execute(
            text(
                f"UPDATE {prefix}workflow_status SET serialization = 'py_pickle', inputs = "
                ":payload WHERE workflow_uuid = :id"
            ),
            pickled,
        )
        for table in dict.fromkeys(table for table, _ in READ):
            columns = {c["name"]: c for c in found.get_columns(table, schema)}
            values = {
                name: 1 if "INT" in str(c["type"]).upper() else "x"
                for name, c in columns.items()
                if not c["nullable"] and c["default"] is None
            }
            values |= {column: planted(ran) for of, column in READ if of == table}
            values |= {"workflow_uuid": victim} if "workflow_uuid" in columns else {}
            values |= {"serialization": "py_pickle"} if "serialization" in columns else {}
            values |= {"destination_uuid": victim} if "destination_uuid" in columns else {}
            if table == "workflow_status":
                state = {
                    "name": WORKFLOW,
                    "queue_name": QUEUE,
                    "status": "ENQUEUED",
                    "workflow_uuid": uuid.uuid4().hex,
                    "application_version": "1",
                }
                values |= {**state, "recovery_attempts": 0, "priority": 0}
            names = ", ".join(f'"{name}"' for name in values)
            connection.execute(
                text(
                    f"INSERT INTO {prefix}{table} ({names}) VALUES "
                    f"({', '.join(':' + n for n in values)})"
                ),
                values,
            )


def test_the_worker_beside_a_server_is_given_none_of_the_servers_secrets(tmp_path):
    service = Service(embedded(tmp_path / "data"), signing_key=SIGNING_KEY)
    server = service.start_server(kept=True)
    try:
        environments = until(
            lambda: [e for e in environments_below(server.pid) if b"TRUEUP_DATA_DIR" in e]
        )
        with closing(Client(service.url)) as client:  # as admin, and the server has the key
            assert client.audit_key() == Signer.from_text(SIGNING_KEY).verifier
        assert all(
            SIGNING_KEY.encode() not in e and b"TRUEUP_ADMIN_TOKEN" not in e for e in environments
        )
    finally:
        service.stop()


def environments_below(pid: int) -> list[bytes]:
    """The environments of a process's children."""
    children = Path(f"/proc/{pid}/task").glob("*/children")
    return [
        Path(f"/proc/{child}/environ").read_bytes()
        for path in children
        for child in path.read_text().split()
    ]
