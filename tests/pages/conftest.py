"""A browser, and somebody who has signed in, for the pages of a service that a file runs."""

import pytest

from tests.support.browser import Seat, browsing


@pytest.fixture(scope="module")
def browser():
    with browsing() as opened:
        yield opened


@pytest.fixture(scope="module")
def cookies(browser, running):
    seat = Seat(browser, running)
    seat.sign_in()
    kept = seat.context.storage_state()
    seat.context.close()
    return kept
