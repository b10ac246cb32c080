"""Every digit that the chapter prints, from a run."""

import pytest

from trueup.chapter.figures import run_chapter
from trueup.chapter.published import PUBLISHED, printed_like

pytestmark = pytest.mark.slow  # whole diagnoses, designs or installations

DIGITS = [
    (table, row, column, digits)
    for table, rows in PUBLISHED.items()
    for row, columns in rows.items()
    for column, digits in columns.items()
]


@pytest.fixture(scope="module")
def tables():
    return {t.title: t.rows for t in run_chapter()}


@pytest.mark.parametrize(("table", "row", "column", "digits"), DIGITS)
def test_a_published_digit_comes_out_of_the_run(tables, table, row, column, digits):
    assert printed_like(tables[table][row][column], digits) == digits


def test_the_nominal_curve_of_the_delay_sweep_falls(tables):
    errors = [
        row["nominal"] for name, row in tables["Delay sweep"].items() if name.startswith("delay ")
    ]
    assert errors == sorted(errors, reverse=True)
    assert len(errors) == 6


def test_the_monitors_threshold_is_exactly_zero(tables):
    assert tables["Monitor"]["quantile 0.99"]["threshold"] == 0.0


def test_an_exact_model_that_brings_the_observation_forward_undoes_the_delay(tables):
    without = tables["Delay sweep"]["delay 0"]["residual"]
    for row in tables["Delay sweep"].values():  # the last of them late in turn, and out of order
        assert row["residual, brought forward"] == pytest.approx(without, rel=1e-6)


def test_the_identification_has_full_rank(tables):
    assert tables["Identification"]["deployment"]["rank"] == 3


def test_the_rollout_bound_is_zero_without_a_step_and_linear_at_one(tables):
    assert tables["Rollout bound"]["no step"]["bound"] == 0.0
    assert tables["Rollout bound"]["L = 1, 50 steps of 0.001"]["bound"] == pytest.approx(0.05)


def test_every_published_table_is_held():
    assert len(DIGITS) == 82
