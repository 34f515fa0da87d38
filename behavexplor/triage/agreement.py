"""How well a classification agrees with the truth, over sequences of labels."""

from collections.abc import Sequence
from dataclasses import dataclass

from sklearn.metrics import adjusted_rand_score, precision_recall_fscore_support

from behavexplor.errors import InputError


@dataclass(frozen=True)
class Agreement:
    """How well labels agree with true ones.

    Attributes:
        n: how many were compared.
        equal: the share that is equal; only where both are of the same names.
        precision: mean over the names of the share of those labeled so that truly are so.
        recall: mean over the true names of the share of those truly so that are labeled so.
        adjusted_rand: whether the same ones are grouped together, whatever their names: 1 for equal groups, about 0 by
            chance.
    """

    n: int
    equal: float
    precision: float
    recall: float
    adjusted_rand: float


def agreement(true: Sequence[str], given: Sequence[str]) -> Agreement:
    """Compare labels with true ones.

    Args:
        true: labels.
        given: others, of the same things in the same order.

    Raises:
        InputError: if there are none, or not as many of both.
    """
    if not true or len(true) != len(given):
        raise InputError(f"Labels can only be compared one by one: there are {len(true)} and {len(given)}")
    equal = sum(a == b for a, b in zip(true, given, strict=True)) / len(true)
    precision, recall = (
        precision_recall_fscore_support(true, given, labels=sorted(set(names)), average="macro", zero_division=0.0)[i]
        for i, names in enumerate((given, true))
    )
    return Agreement(len(true), equal, float(precision), float(recall), float(adjusted_rand_score(true, given)))
