"""p-values in sentences and pages."""

import pytest

from afdsvc.api.evidence import p_value_text
from afdsvc.stats.whiteness import Whiteness


@pytest.mark.parametrize(("p", "words"), [(0.0, "p < 1e-09"), (3e-40, "p < 1e-09"), (1e-9, "p = 1e-09"), (0.0321, "p = 0.032"), (1.0, "p = 1")])
def test_a_p_value_is_never_nothing(p, words):
    assert p_value_text(p) == words


def test_a_sentence_gives_the_bound():
    assert Whiteness(1000, 0.0, 1.0, 1.0, (1.0,)).reason(0.01) == "the quiet residual is not white (p < 1e-09): the model is incomplete"
