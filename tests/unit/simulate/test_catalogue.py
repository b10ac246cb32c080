"""What the second simulator can hide, beside what a diagnosis can name."""

from trueup.model.effect import effects
from trueup.simulate.machine import BEYOND
from trueup.simulate.trial import CATALOGUE


def test_what_is_hidden_as_beyond_the_catalogue_has_no_name_in_it():
    assert not set(BEYOND) & set(effects())


def test_what_is_hidden_as_of_the_catalogue_can_be_named():
    assert set(CATALOGUE) <= set(effects())
