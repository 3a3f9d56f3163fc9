"""Options that make no sense are refused by name."""

from __future__ import annotations

import pytest

from afdsvc.errors import BadInput
from afdsvc.identify.options import IdentifyOptions


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"norm": 3}, "option norm = 3; expected 1 or 2"),
        ({"groups": 2}, "option groups = 2; expected 0"),
        ({"method": "magic"}, "option method = 'magic'; expected one of auto"),
        ({"weighting": "heavy"}, "option weighting = 'heavy'; expected one of"),
    ],
)
def test_refused(wrong, sentence):
    with pytest.raises(BadInput, match=sentence):
        IdentifyOptions(**wrong)
