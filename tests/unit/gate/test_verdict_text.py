"""Verdicts in words: why a candidate was rejected, and whether its recordings settle that."""

import pytest

from trueup.gate.verdict_text import can_be_settled, reasons, unsettled_words


def verdict(ratio=1.1, ci95=(0.742, 1.68), *, passed=False, bound=1.0, **more):
    incumbent = 0.24
    return {
        "rule": "one_step_no_worse",
        "passed": passed,
        "value": (ratio or 0.0) * incumbent,
        "threshold": bound * incumbent,
        "because": "one-step error 0.264, the incumbent's is 0.24",
        "ratio": ratio,
        "ci95": ci95,
        "require": "mean",
        **more,
    }


def test_a_refusal_whose_interval_includes_the_bound_is_not_settled():
    [(rule, reason)] = reasons([verdict(), verdict(0.3, (0.2, 0.4), passed=True)])
    assert rule == "one_step_no_worse"
    assert reason == (
        "the error is 1.1 times the incumbent's, and 1 times is allowed; these recordings do not "
        "settle it: the 95 % interval of the ratio, 0.742 to 1.68, includes the bound 1"
    )
    assert can_be_settled([verdict(), verdict(0.3, (0.2, 0.4), passed=True)])


def test_a_refusal_beyond_its_interval_is_settled():
    clear = verdict(13.7, (8.65, 20.6), bound=0.98)
    assert reasons([clear])[0][1] == (
        "the error is 13.7 times the incumbent's, and 0.98 times is allowed"
    )
    assert not can_be_settled([clear, verdict()])
    assert not can_be_settled([verdict(0.3, (0.2, 0.4), passed=True)])


def test_a_rule_that_passes_within_its_interval_says_so():
    assert unsettled_words(verdict(0.9, (0.7, 1.2), passed=True)).endswith(
        "0.7 to 1.2, includes the bound 1"
    )
    assert unsettled_words(verdict(0.9, (0.7, 0.95), passed=True)) == ""


def test_where_the_interval_must_stay_within_the_bound_its_lower_end_says_what_is_settled():
    assert can_be_settled([verdict(0.9, (0.7, 1.2), require="bound")])
    assert not can_be_settled([verdict(1.5, (1.2, 1.9), require="bound")])


@pytest.mark.parametrize(
    "refused",
    [
        verdict(0.5, (0.4, 0.6), because="breaches 0.2 of the time"),
        verdict(0.5, (0.4, 1.6), because="breaches 0.2 of the time"),
        verdict(None, None, value=None, because="breaches 0.2 of the time"),
        verdict(0.0, None, because="breaches 0.2 of the time"),
    ],
)
def test_what_something_else_than_the_error_refused_has_the_rules_own_reason(refused):
    if refused["ratio"] is None:
        refused["threshold"] = 1.0
    assert reasons([refused])[0][1] == "breaches 0.2 of the time"
    assert not can_be_settled([refused])
