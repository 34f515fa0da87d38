import numpy as np
import pytest

from behavexplor.data.motion_bytes import pack_motion, unpack_motion
from behavexplor.data.trace import RESOLUTION


def steps(*differences):
    """Return positions with these second differences, shape (T, 1)."""
    return np.cumsum(np.cumsum(np.array(differences, dtype=np.int64)))[:, None] * 1.0


@pytest.mark.parametrize(
    ("differences", "size"),
    [
        ([0, 0, 0], 1),
        ([127, -128], 1),
        ([128], 2),
        ([-129], 2),
        ([32767, -32768, 0], 2),
        ([-32769], 3),
        ([2**39 - 1, -(2**39)], 5),
        ([2**39], 6),
        ([2**52, -(2**52)], 7),
    ],
)
def test_differences_take_as_few_bytes_as_they_need(differences, size):
    motion = steps(*differences)
    planes = pack_motion(motion, 1.0)
    assert planes.shape == (size, 1, len(differences))
    assert np.array_equal(unpack_motion(planes, len(differences), 1.0), motion)


@pytest.mark.parametrize("seed", range(5))
def test_motion_is_restored(seed):
    rng = np.random.default_rng(seed)
    motion = np.rint(rng.normal(0, 10.0 ** (2 * seed), (40, 3, 2)) / RESOLUTION) * RESOLUTION
    assert np.array_equal(unpack_motion(pack_motion(motion, RESOLUTION), 40, RESOLUTION), motion)
