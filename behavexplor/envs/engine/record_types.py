"""Types of records: structured numpy data whose fields are attributes, in kernels as in Python."""

from typing import TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

Records = NDArray[np.record]
RecordType: TypeAlias = np.dtype[np.record]


def record_type(**fields: type) -> RecordType:
    """Create the type of a record.

    Args:
        fields: type of each field, in their order in memory.
    """
    return cast("RecordType", np.dtype((np.record, np.dtype(list(fields.items()), align=True))))
