"""Canonical bytes are those of RFC 8785, whoever writes them."""

import pytest
import rfc8785
from hypothesis import given
from hypothesis import strategies as st

from trueup.canonical import NotCanonical, _by_the_letter, canonical_bytes

ODD_NUMBERS = [
    1e16, 1e21, 1e-6, 1e-7, 0.1 + 0.2, 5e-324, -0.0, 1.0, 2**53, 2**53 - 1, 2**53 + 1, 1e15,
    123456789012345680.0, 0.000001234, float("nan"), float("inf"), 10**25,
]  # fmt: skip
ODD_TEXT = st.text(alphabet='\x00\x1f\x7f\u2028\ud7ff\ue000\uffff\U00010000"\\/abc:,[1.0e5')
LEAVES = st.one_of(
    st.floats(),
    st.floats(min_value=-1e3, max_value=1e3),
    st.integers(),
    st.sampled_from(ODD_NUMBERS),
    st.text(),
    ODD_TEXT,
    st.booleans(),
    st.none(),
)
DOCUMENTS = st.recursive(
    LEAVES,
    lambda inner: st.one_of(
        st.lists(inner), st.tuples(inner, inner), st.dictionaries(ODD_TEXT | st.text(), inner)
    ),
    max_leaves=20,
)


def bytes_or_none(write, document):
    try:
        return write(document)
    except NotCanonical:
        return None


@given(DOCUMENTS)
def test_the_quick_way_writes_the_same_bytes(document):
    assert bytes_or_none(canonical_bytes, document) == bytes_or_none(_by_the_letter, document)


@pytest.mark.parametrize("document", [float("nan"), [float("inf")], {"a": 2**60 + 1}, "\ud800"])
def test_what_has_no_canonical_form_is_refused(document):
    with pytest.raises(NotCanonical):
        canonical_bytes(document)


@pytest.mark.parametrize(
    "document", [1.0, [1e16, 1e-7], {"b": 0.1, "a": None}, {"\U00010000": 1, "\uffff": 2}]
)
def test_they_are_those_of_the_reference(document):
    assert canonical_bytes(document) == rfc8785.dumps(document)
