"""What an error says where nobody catches it."""

import traceback

import pytest

from trueup.errors import BadPlant
from trueup_client.problem import Problem


@pytest.mark.parametrize("given", [{}, {"hint": "Give k."}])
def test_a_traceback_ends_with_what_to_do_next(given):
    error = BadPlant("k is missing", **given)
    shown = traceback.format_exception_only(error)
    assert shown[-1].strip() == f"hint: {error.hint}"


def test_so_does_a_refusal_of_the_service():
    error = Problem(404, {"code": "not-found", "detail": "no arm", "hint": "Register it."})
    assert traceback.format_exception_only(error)[-1].strip() == "hint: Register it."
