"""A browser, and somebody who has signed in, for the pages of a service that a file runs."""

import pytest

from tests.support.browser import Seat, browsing
from tests.support.service import Service
from tests.support.storage import scaled


@pytest.fixture(scope="module")
def browser():
    with browsing() as opened:
        yield opened


@pytest.fixture(scope="module")
def on_servers(tmp_path_factory, postgres, s3):
    """A service on the stricter of the two databases: what pages ask of either, `tests/http` has,
    and the way through them on the other one `test_day` and `test_pages`."""
    with Service(scaled(tmp_path_factory.mktemp("pages"), postgres, s3)).running() as service:
        yield service


@pytest.fixture(scope="module")
def cookies(browser, running):
    seat = Seat(browser, running)
    seat.sign_in()
    kept = seat.context.storage_state()
    seat.context.close()
    return kept
