"""Servers and storages that the tests bring themselves."""

from __future__ import annotations

import gc
import json
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from tests.support.postgres import Postgres, start_postgres
from tests.support.s3 import S3, start_s3
from tests.support.service import ADMIN, Service
from tests.support.storage import Storage, requested, scaled
from trueup import cores
from trueup_client import Client

settings.register_profile("trueup", deadline=None)  # no test is about how fast a machine is
settings.load_profile("trueup")
os.environ["TRUEUP_ADMIN_TOKEN"] = os.environ["TRUEUP_TOKEN"] = ADMIN
EXAMPLE = Path(__file__).parent.parent / "examples" / "emps"


def pytest_configure(config: pytest.Config) -> None:
    """Keeps a diagnosis to one core where several processes of tests use the others."""
    if hasattr(config, "workerinput"):
        cores.use_one()


def pytest_collection_finish() -> None:
    """Keeps what was loaded out of each garbage collection of the tests."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def postgres(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Postgres]:
    with start_postgres() as server:
        yield server


@pytest.fixture(scope="session")
def s3() -> Iterator[S3]:
    with start_s3() as server:
        yield server


@pytest.fixture(params=["embedded", "scaled"])
def storage(request: pytest.FixtureRequest, tmp_path: Path) -> Storage:
    """A fresh storage: SQLite and a folder, then PostgreSQL and S3."""
    return requested(request, tmp_path / "data")


@pytest.fixture(scope="module", params=["embedded", "scaled"])
def service(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Service]:
    """A running server with a worker, for all tests of a file. Each test uses its own plants.

    It ends with the file, so that each file begins with an empty log.
    """
    storage = requested(request, tmp_path_factory.mktemp("service"))
    with Service(storage).running() as running:
        yield running


@pytest.fixture(scope="module")
def scaled_service(
    tmp_path_factory: pytest.TempPathFactory, postgres: Postgres, s3: S3
) -> Iterator[Service]:
    """A running server with a worker on PostgreSQL and S3 alone.

    For test files whose steps other tests take on embedded storage, or whose requests `tests/http`
    sends on both storages.
    """
    with Service(scaled(tmp_path_factory.mktemp("service"), postgres, s3)).running() as running:
        yield running


@pytest.fixture
def client(service: Service) -> Iterator[Client]:
    with Client(service.url, actor="tester") as opened:
        yield opened


@pytest.fixture
def emps_plant() -> dict:
    return json.loads((EXAMPLE / "plant.json").read_text())


@pytest.fixture
def emps() -> Path:
    return EXAMPLE
