"""Images of a result: their legends name each colour once."""

import numpy as np

from huesphere.recover.io.images import legend
from huesphere.recover.reasons import Reason


def test_a_legend_names_each_colour_once_with_all_that_it_stands_for():
    reason = np.array([[0, Reason.ALL_LIT, Reason.INTERPOLATED, Reason.INTERPOLATED_DARK, Reason.SATURATED]])
    assert legend(reason) == "blue all-lit, yellow interpolated or interpolated-dark, purple saturated"
