"""Pages are rendered from templates that share what they know."""

import pytest

from trueup_pages.rendering import render


def test_a_value_cannot_hide_what_every_template_knows():
    with pytest.raises(TypeError, match="drawing"):
        render("problem.html", drawing={})
