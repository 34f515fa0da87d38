"""Agreement of two classifications, given as sequences of labels."""

from collections.abc import Sequence
from dataclasses import dataclass

from behavexplor.errors import InputError


@dataclass(frozen=True)
class Agreement:
    """Agreement of given labels with true labels.

    Attributes:
        n: number of compared labels.
        equal: share of equal labels; meaningful only if both sequences use the same names.
        precision: mean over the given names of the share of items with that label for which it is true.
        recall: mean over the true names of the share of items with that true label that were given it.
        adjusted_rand: adjusted Rand index, which compares the groups and ignores their names: 1 for equal groups,
            about 0 for groups made by chance.
    """

    n: int
    equal: float
    precision: float
    recall: float
    adjusted_rand: float


def agreement(true: Sequence[str], given: Sequence[str]) -> Agreement:
    """Compare given labels with true labels.

    Args:
        true: true labels.
        given: given labels of the same items, in the same order.

    Raises:
        InputError: if there are no labels, or the sequences differ in length.
    """
    from sklearn.metrics import (  # noqa: PLC0415 - slow to import
        adjusted_rand_score,
        precision_recall_fscore_support,
    )

    if not true or len(true) != len(given):
        raise InputError(f"Labels are compared one by one, so {len(true)} and {len(given)} labels do not match")
    equal = sum(a == b for a, b in zip(true, given, strict=True)) / len(true)
    precision, recall = (
        precision_recall_fscore_support(true, given, labels=sorted(set(names)), average="macro", zero_division=0.0)[i]
        for i, names in enumerate((given, true))
    )
    return Agreement(len(true), equal, float(precision), float(recall), float(adjusted_rand_score(true, given)))
