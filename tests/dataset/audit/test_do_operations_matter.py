"""A do-operation that changes nothing is named."""

import pytest

from cophy.audit.data import do_operations_matter, matters
from tests.dataset.audit.failing import failing


def test_a_d_that_is_b_is_caught(tiny) -> None:
    spec, arrays = tiny
    if spec.scenario.significant_effect_m is None:
        pytest.skip("the search for towers promises nothing")
    assert not failing(do_operations_matter(arrays, spec))
    changed = arrays["states"].copy()
    changed[4, 1] = changed[4, 0]
    assert failing(do_operations_matter(arrays | {"states": changed}, spec)) == {"the do-operation matters"}


def test_an_object_that_is_displaced_and_nothing_else_matters_only_to_itself(tiny) -> None:
    spec, arrays = tiny
    changed = arrays["states"].copy()
    changed[:, 1] = changed[:, 0]
    changed[range(len(changed)), 1, :, arrays["do_slot"], 0] += 2 * spec.scenario.min_difference
    arrays = arrays | {"states": changed}
    there = arrays["presence"][range(len(changed)), 1, arrays["do_slot"]]
    assert matters(arrays, spec) == there.mean()
    assert matters(arrays, spec, acted_on=False) == 0
