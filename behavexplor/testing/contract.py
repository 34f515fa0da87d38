"""The error of a broken contract, and how to raise it."""


class ContractError(AssertionError):
    """An implementation breaks a promise of its interface; the message says which one, and how."""


def promise(kept: object, sentence: str) -> None:
    """Raise a `ContractError` unless a promise is kept.

    Args:
        kept: whether the promise is kept.
        sentence: what is wrong, and what the interface asks for.
    """
    if not kept:
        raise ContractError(sentence)
