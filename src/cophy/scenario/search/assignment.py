"""What an index prescribes for its twin pair, so that a dataset is balanced by construction.

Consecutive pairs form a block that shares one pair of confounder configurations (c1, c2) and one kind of
do-operation, and goes through all cells once. Every configuration therefore meets every cell equally often:
no value of any confounder says anything about the outcome.
"""

from dataclasses import dataclass

import numpy as np

from cophy.errors import CophyError


@dataclass(frozen=True)
class Assignment:
    """first: configuration of the first twin; seconds: candidates for the second, in the order to try them.

    do_operation, cell: indices into the scenario's kinds of do-operations and its cells.
    """

    first: int
    seconds: tuple[int, ...]
    do_operation: int
    cell: int


def seen_configurations(num_configurations: int, data_seed: int) -> np.ndarray:
    """(configuration,) bool: the half that † splits train on; the other half they only test on (paper Table 2)."""
    seen = np.zeros(num_configurations, dtype=bool)
    seen[np.random.default_rng((data_seed, 0x5EED)).permutation(num_configurations)[: num_configurations // 2]] = True
    return seen


def assign(pair: int, *, data_seed: int, num_configurations: int, num_do_operations: int, num_cells: int) -> Assignment:
    """The assignment of a twin pair: a pure function of its index, the seed and the scenario's counts.

    Both twins come from the same half of the configurations, so that † splits keep twins together. Each half is
    cycled through in a fresh permutation per cycle.

    Args:
        pair: index of the twin pair in the dataset.
        data_seed: of the dataset.
        num_configurations: of the confounders.
        num_do_operations: kinds of do-operation.
        num_cells: cells that a block goes through.

    Raises:
        CophyError: too few configurations for twins that differ.
    """
    block, cell = divmod(pair, num_cells)
    turn, half = divmod(block, 2)
    seen = seen_configurations(num_configurations, data_seed)
    configurations = np.flatnonzero(seen == bool(half))
    if len(configurations) < 2:
        raise CophyError(
            "scenario.confounders leave too few configurations for twins: give some confounder more values"
        )
    cycle, rank = divmod(turn, len(configurations))
    order = np.random.default_rng((data_seed, cycle, half, 0xC0)).permutation(configurations)
    shift = 1 + int(np.random.default_rng((data_seed, cycle, half, 0xC1)).integers(len(order) - 1))
    seconds = np.roll(order, -(rank + shift))
    first = order[rank]
    return Assignment(
        first=int(first),
        seconds=tuple(int(second) for second in seconds if second != first),
        do_operation=turn % num_do_operations,
        cell=cell,
    )
