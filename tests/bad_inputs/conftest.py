"""How a table of bad inputs is read: each row is a call, and the words of the error it ends in.

To add a row, write what somebody might type, and what they should read then: parts of the message
in their order, with `...` between them.
"""

import pytest


@pytest.fixture
def refused():
    """Check that a call is refused with a ValueError that has these words, in this order."""

    def check(call, words):
        with pytest.raises(ValueError) as raised:  # noqa: PT011 (the words are looked for below)
            call()
        rest = str(raised.value)
        for part in words.split("..."):
            before, found, rest = rest.partition(part)
            assert found, f"{part!r} is not in {before!r}"

    return check
