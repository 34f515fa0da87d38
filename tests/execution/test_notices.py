"""What libraries log while something is loaded is kept, and not printed."""

import logging
import warnings

import pytest

from behavexplor.execution.evaluator import collected_notices


def test_warnings_of_both_kinds_are_kept_as_printable_lines_and_not_printed(capsys):
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        with collected_notices() as notices:
            logging.getLogger("some.library").warning("clears \x1b[2J %s\nand more", "all")
            logging.getLogger("some.library").info("no more than that")
            logging.getLogger("behavexplor.jit").warning("Compiling ...")
            warnings.warn("old\x07 way", UserWarning, stacklevel=1)
    assert notices == ["clears \\x1b[2J all and more", "old\\x07 way"]
    assert capsys.readouterr() == ("", "")


def test_afterwards_nothing_is_kept():
    with pytest.raises(KeyError), collected_notices() as notices:
        raise KeyError
    logging.getLogger("some.library").warning("later")
    assert notices == []
