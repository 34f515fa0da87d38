"""Pickles are read, and never run."""

import pickle
import subprocess
from collections import OrderedDict

import cloudpickle
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from behavexplor.ads.sb3.arrays import as_array
from behavexplor.ads.sb3.inert import MAX_STEPS, OWN_CODE, Inert, PickleReader, TooLongError, check_extent, read_pickle
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


@given(plain)
def test_sets_are_kept_as_their_items(value):
    read, _ = read_pickle(pickle.dumps([{1, "a"}, frozenset([2]), value]))
    assert [set(read[0].items), read[1].items, read[2]] == [{1, "a"}, [2], value]


def test_a_pickle_made_to_fill_the_memory_does_not():
    value, _ = read_pickle(b"\x80\x04N" + b"r" + (2**31).to_bytes(4, "little") + b".")
    assert value is None


def test_a_function_is_read_and_its_making_is_ordinary():
    factor = 2.0
    read, names = read_pickle(cloudpickle.dumps(lambda part: factor * part))
    assert isinstance(read, Inert)
    assert OWN_CODE not in names


def made_class():
    """A class that cloudpickle puts into a pickle, because no module has it."""
    return type("Made", (), {"__module__": "__main__", "__call__": lambda self, part: part})


def test_what_a_pickle_brings_along_and_calls_is_named():
    calling = b"\x80\x04" + cloudpickle.dumps(lambda: None)[2:-1] + b")R."
    for data in (cloudpickle.dumps(made_class()()), calling, cloudpickle.dumps(made_class()(), protocol=1)):
        assert OWN_CODE in read_pickle(data)[1]
    assert OWN_CODE not in read_pickle(cloudpickle.dumps(made_class()))[1]


def test_a_module_that_a_function_imports_is_named():
    _, names = read_pickle(cloudpickle.dumps(lambda: subprocess.run([], check=True)))
    assert "cloudpickle.cloudpickle.subimport(subprocess)" in names


def shared(levels):
    """A tuple of nothing, `levels` times paired with itself, as the instructions of a pickle without its end."""
    return b"\x80\x04)" + b"2\x86" * levels


def test_values_are_counted_as_often_as_they_are_used():
    few, many, deep = (read_pickle(shared(levels) + b".")[0] for levels in (10, 30, 1000))
    check_extent(few)
    with pytest.raises(ValueError, match="more than 100000 parts"):
        check_extent(many)
    with pytest.raises(ValueError, match="nested too deeply"):
        check_extent(deep)


@pytest.mark.parametrize("key", [shared(60)[2:], pickle.dumps(2**61 - 1)[2:-1]], ids=["shared tuples", "large integer"])
def test_keys_that_take_long_to_compare_are_refused(key):
    with pytest.raises(ValueError, match="as a key"):
        read_pickle(b"\x80\x04}" + key + b"Ns.")


def test_a_value_that_contains_itself_is_read_and_not_walked_through():
    value = [1]
    value.append(value)
    read, _ = read_pickle(pickle.dumps(value))
    assert read[1] is read
    with pytest.raises(ValueError, match="nested too deeply"):
        check_extent(read)


def test_all_pickles_of_a_reader_together_have_a_limit():
    reader = PickleReader()
    half = b"\x80\x04" + b"N0" * (MAX_STEPS // 4) + b"N."
    assert reader.read(half)[0] is None
    with pytest.raises(TooLongError, match="instructions"):
        reader.read(half)


@pytest.mark.parametrize("value", [np.array(["a"]), np.array([{}], dtype=object), OrderedDict(), "x", None, [1.0]])
def test_what_is_no_array_of_numbers_is_refused(value):
    with pytest.raises(ValueError, match="array"):
        as_array(read_pickle(pickle.dumps(value))[0])


@pytest.mark.parametrize("shape", [(0, 2**70), (5, 25, 0, 10**18), (-1, 0), (2,) * 70])
def test_a_shape_that_no_array_has_is_refused(shape):
    state = (1, shape, Inert("numpy.dtype", ("f8", False, True), (3, "<")), False, b"")
    with pytest.raises(ValueError, match=r"array|dimension"):
        as_array(Inert("numpy.core.multiarray._reconstruct", (), state))
