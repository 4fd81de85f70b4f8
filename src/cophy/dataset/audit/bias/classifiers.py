"""Classifiers that are asked for an outcome they should not know.

Each experiment is judged once, by a classifier fitted without it and without its twin.
"""

import numpy as np
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.model_selection import GroupKFold
from threadpoolctl import threadpool_limits

from cophy.bootstrap import interval
from cophy.dataset.audit.checks import ClassifierCheck

NUM_FOLDS = 5
# above chance; ours. The paper's data allow 0.8 % more than "all blocks stay" (Table 6 right: 71.8, 71.0 %)
MAX_BIAS = 0.02
MIN_EXPERIMENTS = 2000  # from which on MAX_BIAS is asked for; below, three standard deviations where that is more


def ask_classifier(
    name: str, features: np.ndarray, outcome: np.ndarray, twin: np.ndarray, *, chance: float = 0.5, expected: str = ""
) -> ClassifierCheck:
    """How often a classifier guesses a binary outcome.

    Args:
        name: the question, as the line of the audit says it.
        features: (experiment, feature) what it sees.
        outcome: (experiment,) bool, what it is asked for.
        twin: (experiment,) twin pair.
        chance: the share that is right without looking.
        expected: why more than that is no fault but a fact; it is reported then.
    """
    right = (foretold(features, outcome, twin) == outcome).astype(float)
    accuracy, (low, high) = float(right.mean()), interval(right, twin)
    margin = MAX_BIAS
    if len(right) < MIN_EXPERIMENTS:
        margin = max(MAX_BIAS, 3 * 0.5 / float(np.sqrt(len(np.unique(twin)))))
    found = f"{accuracy:.1%} [{low:.1%}, {high:.1%}] of {len(right)}, by chance {chance:.1%}, "
    found += f"no limit: {expected}" if expected else f"at most {chance + margin:.1%}"
    return ClassifierCheck(name, found, bool(expected) or accuracy <= chance + margin, accuracy, low, high, chance)


def foretold(features: np.ndarray, outcome: np.ndarray, twin: np.ndarray) -> np.ndarray:
    """What boosted trees predict from the features, cross-validated over twin pairs.

    The trees regress on 0 and 1, so that a fold may lack one of the two outcomes. They use one thread. On trees this
    small, several threads wait for each other; beside other work they take many times as long.

    Args:
        features: (experiment, feature).
        outcome: (experiment,) bool.
        twin: (experiment,) twin pair.

    Returns:
        (experiment,) bool.
    """
    found = np.zeros(len(outcome), dtype=bool)
    with threadpool_limits(1):
        for fitted, tested in GroupKFold(NUM_FOLDS).split(features, groups=twin):
            trees = HistGradientBoostingRegressor(
                learning_rate=0.05, max_leaf_nodes=8, early_stopping=False, random_state=0
            )
            found[tested] = trees.fit(features[fitted], outcome[fitted]).predict(features[tested]) > 0.5
    return found
