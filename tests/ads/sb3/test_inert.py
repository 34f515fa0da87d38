"""Pickles are read, and never run."""

import pickle
from collections import OrderedDict

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from behavexplor.ads.sb3.inert import Inert, as_array, read_pickle
from tests.ads.sb3.models import Payload

PROTOCOLS = range(pickle.HIGHEST_PROTOCOL + 1)
plain = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text() | st.binary(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4) | st.tuples(inner, inner),
    max_leaves=12,
)
numbers = arrays.arrays(
    st.sampled_from(["f4", "f8", "i2", "i8", "u1", "b1", ">f8"]),
    arrays.array_shapes(min_dims=0, max_dims=3, min_side=0),
)


@given(plain)
def test_plain_values_are_read_as_they_are(value):
    assert read_pickle(pickle.dumps(value)) == (value, frozenset())


@given(numbers, st.sampled_from([2, 3, 4, 5]), st.booleans())
def test_arrays_are_read_as_they_are(array, protocol, in_columns):
    array = np.asfortranarray(array) if in_columns else array
    read = as_array(read_pickle(pickle.dumps(array, protocol=protocol))[0])
    np.testing.assert_array_equal(read, array)
    assert read.shape == array.shape


@pytest.mark.parametrize("scalar", [np.float64(1.5), np.int64(-3), np.bool_(True), 2.5, 7, True])
def test_scalars_are_read_as_they_are(scalar):
    assert as_array(read_pickle(pickle.dumps(scalar))[0]) == scalar


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_nothing_is_run(tmp_path, protocol):
    value, names = read_pickle(pickle.dumps({"a": Payload(tmp_path / "made")}, protocol=protocol))
    assert not (tmp_path / "made").exists()
    assert names == {"posix.mkdir"}
    assert value["a"].name == "posix.mkdir"
    assert value["a"].arguments == (str(tmp_path / "made"),)


def test_what_would_have_been_put_into_an_object_is_kept():
    value, names = read_pickle(pickle.dumps(OrderedDict(a=1, b=[2])))
    assert isinstance(value, Inert)
    assert (names, value.items) == ({"collections.OrderedDict"}, [("a", 1), ("b", [2])])


@pytest.mark.parametrize("value", [{"a": np.arange(9.0)}, OrderedDict(a=1), [1, "x" * 300, (None,)]])
def test_a_pickle_cut_short_is_refused(value):
    data = pickle.dumps(value)
    for length in range(len(data)):
        with pytest.raises(ValueError, match="not a readable pickle"):
            read_pickle(data[:length])


@given(st.binary(max_size=200))
def test_rubbish_is_read_or_refused(data):
    try:
        read_pickle(data)
    except ValueError as error:
        assert "not a readable pickle" in str(error)


def test_a_pickle_made_to_fill_the_memory_is_refused():
    with pytest.raises(ValueError, match="fill the memory"):
        read_pickle(b"\x80\x04N" + b"r" + (2**31).to_bytes(4, "little") + b".")


@pytest.mark.parametrize("value", [np.array(["a"]), np.array([{}], dtype=object), OrderedDict(), "x", None, [1.0]])
def test_what_is_no_array_of_numbers_is_refused(value):
    with pytest.raises(ValueError, match="array"):
        as_array(read_pickle(pickle.dumps(value))[0])
