"""The laws of a delay, for every signal and every delay."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from trueup.control.delay import delayed, seen_at

WHOLE = st.one_of(st.integers(-5, 40), st.integers(-(2**70), 2**70))
SIGNALS = arrays.arrays(
    st.sampled_from([np.float64, np.float32, np.int64, np.bool_]),
    arrays.array_shapes(min_dims=1, max_dims=3, min_side=0, max_side=12),
)


@given(SIGNALS, WHOLE)
def test_a_delayed_signal_has_the_shape_and_type_of_the_signal_and_is_no_view(signal, delay):
    late = delayed(signal, delay)
    assert (late.shape, late.dtype) == (signal.shape, signal.dtype)
    assert not np.shares_memory(late, signal)


@given(SIGNALS, WHOLE)
def test_each_sample_is_the_one_so_many_before_and_the_first_is_repeated(signal, delay):
    late = delayed(signal, delay)
    for i in range(len(signal)):
        assert seen_at(i, delay) == max(0, i - max(0, delay))
        np.testing.assert_array_equal(late[i], signal[seen_at(i, delay)])


@given(SIGNALS, WHOLE, st.integers(0, 11), st.data())
def test_nothing_looks_ahead(signal, delay, after, data):
    after = min(after, len(signal))
    other = signal.copy()
    other[after:] = data.draw(
        arrays.arrays(signal.dtype, signal[after:].shape), label="another future"
    )
    np.testing.assert_array_equal(delayed(other, delay)[:after], delayed(signal, delay)[:after])


@given(SIGNALS, st.integers(max_value=0))
def test_a_negative_delay_is_none(signal, delay):
    np.testing.assert_array_equal(delayed(signal, delay), signal)


@given(SIGNALS, st.integers(0, 20), st.integers(0, 20))
def test_two_delays_add_up(signal, first, second):
    np.testing.assert_array_equal(
        delayed(delayed(signal, first), second), delayed(signal, first + second)
    )


@given(SIGNALS, st.integers(0, 40))
def test_numpys_whole_numbers_count_as_whole(signal, delay):
    np.testing.assert_array_equal(delayed(signal, np.int32(delay)), delayed(signal, delay))


@pytest.mark.parametrize("delay", [1.5, 1.0, True, False, np.True_, np.float64(2), "1", None, [1]])
def test_what_is_no_whole_number_is_refused(delay):
    with pytest.raises(TypeError, match="whole number of samples"):
        delayed(np.zeros(3), delay)
    with pytest.raises(TypeError, match="whole number of samples"):
        seen_at(2, delay)


def test_one_number_is_no_signal():
    with pytest.raises(ValueError, match="axis of samples"):
        delayed(np.array(1.0), 1)
