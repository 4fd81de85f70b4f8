"""What an index prescribes for its twin pair, so that a dataset is balanced by construction.

Consecutive pairs form a block that shares one pair of confounder configurations (c1, c2) and one kind of do-operation.
A scenario has one kind of block or several, in turn, and says which cells the pairs of each go through. In every block
both configurations meet every outcome equally often. So no value of any confounder says anything about the outcome.
"""

import math
from dataclasses import dataclass

import numpy as np

from cophy.errors import CophyError

MAX_IN_TURN = 10_000  # configurations that are gone through one by one; of more, a dataset holds few, and any are drawn
NUM_DRAWN = 200  # then: for a twin pair, the first and those that are tried as the second


@dataclass(frozen=True)
class Assignment:
    """first: configuration of the first twin; seconds: candidates for the second, in the order to try them.

    do_operation, cell: indices into the scenario's kinds of do-operations and its cells; the cell is the first twin's.
    """

    first: int
    seconds: tuple[int, ...]
    do_operation: int
    cell: int


def assign(
    pair: int,
    *,
    data_seed: int,
    num_configurations: int,
    seen: np.ndarray | None,
    num_do_operations: int,
    blocks: tuple[tuple[int, ...], ...],
) -> Assignment:
    """The assignment of a twin pair: a pure function of its index, the seed and the scenario.

    Where † splits hold out a half of the configurations, both twins come from the same half, so that these splits keep
    twins together; blocks take turns between the halves.

    Args:
        pair: index of the twin pair in the dataset.
        data_seed: of the dataset.
        num_configurations: of the confounders.
        seen: (configuration,) bool, the half that † splits train on; None where they hold out nothing.
        num_do_operations: kinds of do-operation.
        blocks: kinds of block, each with the cells of its pairs.

    Raises:
        CophyError: too few configurations for twins that differ.
    """
    block, place = divmod(pair, len(blocks[0]))
    halves = [None] if seen is None else [np.flatnonzero(~seen), np.flatnonzero(seen)]
    turn, half = divmod(block, len(halves))
    among = halves[half]
    count = num_configurations if among is None else len(among)
    if count < 2:
        raise CophyError(
            "scenario.confounders leave too few configurations for twins: give some confounder more values"
        )
    if count > MAX_IN_TURN:
        drawn = _any(count, np.random.default_rng((data_seed, turn, 0xC2)))
        first, *seconds = drawn if among is None else among[drawn].tolist()
    else:
        first, *seconds = _in_turn(np.arange(num_configurations) if among is None else among, turn, (data_seed, half))
    meeting = math.lcm(len(blocks), num_do_operations)  # turns after which the same kinds would meet again
    return Assignment(
        first=first,
        seconds=tuple(seconds),
        do_operation=(turn + turn // meeting) % num_do_operations,
        cell=blocks[turn % len(blocks)][place],
    )


def _in_turn(among: np.ndarray, turn: int, seed: tuple[int, int]) -> list[int]:
    """A configuration and all others, in the order to try them; in a fresh permutation per cycle each is the first once."""
    data_seed, half = seed
    cycle, rank = divmod(turn, len(among))
    order = np.random.default_rng((data_seed, cycle, half, 0xC0)).permutation(among)
    shift = 1 + int(np.random.default_rng((data_seed, cycle, half, 0xC1)).integers(len(order) - 1))
    first = order[rank]
    seconds = np.roll(order, -(rank + shift))
    return [int(first), *seconds[seconds != first].tolist()]


def _any(num_configurations: int, rng: np.random.Generator) -> list[int]:
    """Different configurations, each as likely as any."""
    return list(dict.fromkeys(rng.integers(num_configurations, size=NUM_DRAWN).tolist()))
