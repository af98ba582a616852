"""The search for a tolerance, on vertices that are nothing but weights."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rtin._tolerance_search import ToleranceSearch

MOST_WALKS = 100
magnitudes = st.integers(-320, 300).map(lambda power: 10.0**power)


def searched(weights, budget, start, spare=3):
    """The tolerances walked at; as a budget is looked for over a hierarchy."""
    search, tolerances = ToleranceSearch(start), []
    while True:
        tolerances.append(search.tolerance)
        assert len(tolerances) < MOST_WALKS
        assert np.isfinite(search.tolerance)
        assert search.tolerance >= 0.0
        walked = np.sort(weights[weights > search.tolerance])[::-1]
        if len(walked) > 2 * budget + spare and not search.is_narrow:
            search.go_coarser(float(walked[budget]))
        elif len(walked) > budget or search.tolerance == 0.0:
            return tolerances
        else:
            search.go_finer(4 + len(walked), budget)


@given(
    st.lists(st.tuples(magnitudes, st.floats(1.0, 10.0), st.integers(1, 60)), max_size=8),
    st.integers(0, 200),
    magnitudes | st.just(0.0),
)
def test_ends_where_the_budget_is_exceeded_or_nothing_is_left(clusters, budget, start):
    weights = np.concatenate([np.full(n, part * size) for size, part, n in clusters] or [[]])
    tolerance = searched(weights, budget, start)[-1]
    assert (weights > tolerance).sum() > budget or tolerance == 0.0


@pytest.mark.parametrize("start", [1e-3, 1.0, 1e3])
def test_takes_few_walks_where_weights_are_spread(start):
    weights = 10.0 ** np.random.default_rng(1).uniform(-2.0, 2.0, 20_000)
    for budget in (10, 300, 5000):
        assert len(searched(weights, budget, start)) < 16


def test_a_start_that_is_just_fine_enough_is_enough():
    weights = np.arange(1.0, 1001.0)
    assert searched(weights, 100, 890.0) == [890.0]
