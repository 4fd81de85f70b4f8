"""Which half of the configurations † splits train on (paper Table 2); the other half they only test on.

What an index prescribes for its twin pair, so that a dataset is balanced by construction.

Consecutive pairs form a block that shares one pair of confounder configurations (c1, c2) and one kind of do-operation.
A scenario has one kind of block or several, in turn, and says which cells the pairs of each go through. In every block
both configurations meet every outcome equally often. So no value of any confounder says anything about the outcome.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from cophy.errors import CophyError
from cophy.scenario.confounders import ConfounderGrid

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


STARTS = 50  # ours: of the search for level halves
OF_VALUES = 3  # ours: how much more single values count than how they go together


def half_of_problems(grid: ConfounderGrid, num_objects: int, symmetries: np.ndarray, data_seed: int) -> np.ndarray:
    """A half that shares no problem with the other, in which every value is as frequent as the grid allows.

    Args:
        grid: values of the confounders.
        num_objects: of a tower.
        symmetries: (symmetry, 2, 2) matrices on horizontal gravity.
        data_seed: says which half.

    Returns:
        (configuration,) bool.
    """
    values = (tuple(grid.mass), tuple(grid.gravity_x), tuple(grid.gravity_y))
    combinations = _combinations(values, num_objects, tuple(symmetries.ravel().tolist()), data_seed)
    return np.asarray(grid.spread(combinations, num_objects) > 0)


def problems(mass: np.ndarray, gravity_xy: np.ndarray, symmetries: np.ndarray) -> np.ndarray:
    """What combinations have in common that are the same problem.

    Args:
        mass: (combination, object) kg.
        gravity_xy: (combination, 2) m/s².
        symmetries: (symmetry, 2, 2) matrices on gravity.

    Returns:
        (combination, object + 2): masses relative to the largest, then gravity: of all that the symmetries make of it, the last
        in sorted order.
    """
    turned = np.einsum("sij,cj->csi", symmetries, gravity_xy)
    last = np.lexsort((turned[..., 1], turned[..., 0]), axis=1)[:, -1]
    relative = mass / mass.max(axis=1, keepdims=True)
    return np.round(np.hstack([relative, turned[np.arange(len(turned)), last]]), 6) + 0.0  # no -0


@lru_cache(maxsize=64)  # every index of a dataset asks
def _combinations(
    values: tuple[tuple[float, ...], ...], num_objects: int, symmetries: tuple[float, ...], data_seed: int
) -> np.ndarray:
    """(combination,) 1 where it is seen, else 0; in the order of `ConfounderGrid.masses_and_gravities`."""
    masses, gravity_x, gravity_y = map(list, values)
    grid = ConfounderGrid(masses, friction=[1], restitution=[0], gravity_x=gravity_x, gravity_y=gravity_y)
    mass, gravity = grid.masses_and_gravities(num_objects)
    problem = problems(mass, gravity, np.array(symmetries).reshape(-1, 2, 2))
    number = _numbered(problem)
    counted = np.zeros((number.max() + 1, 0), dtype=np.int64)
    for weight, property_ in _level(mass, gravity, problem):
        of_problem = np.zeros((len(counted), property_.max() + 1), dtype=np.int64)
        np.add.at(of_problem, (number, property_), weight)
        counted = np.hstack([counted, of_problem])
    seen = _halve(counted, np.random.default_rng((data_seed, num_objects, 0x5EED)))
    return seen[number].astype(float)


def _level(mass: np.ndarray, gravity: np.ndarray, problem: np.ndarray) -> list[tuple[int, np.ndarray]]:
    """Weight and (combination,) number of each property that shall be as frequent in both halves."""
    num_objects = mass.shape[1]
    single = [gravity[:, :1], gravity[:, 1:], *(mass[:, [k]] for k in range(num_objects))]
    of_gravity = problem[:, num_objects:]
    joint = [problem[:, :num_objects], *(np.hstack([mass[:, [k]], of_gravity]) for k in range(num_objects))]
    return [(OF_VALUES, _numbered(each)) for each in single] + [(1, _numbered(each)) for each in joint]


def _numbered(rows: np.ndarray) -> np.ndarray:
    """(row,) the same number for equal rows, from 0."""
    return np.unique(rows, axis=0, return_inverse=True)[1].reshape(-1)


def _halve(counted: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Spread items over two sides so that each column has nearly the same sum on both.

    From random sides on, the one or two items whose change of side helps most change it, until nothing helps.

    Args:
        counted: (item, column) integers.
        rng: says where to start.

    Returns:
        (item,) bool.
    """
    shared, least, best = counted @ counted.T, np.inf, np.zeros(len(counted), dtype=bool)
    for _ in range(STARTS):
        side = 2 * rng.integers(2, size=len(counted)) - 1
        while True:
            alone = 4 * (np.diag(shared) - side * (shared @ side))
            change = alone[:, None] + alone + 8 * np.outer(side, side) * shared
            np.fill_diagonal(change, alone)
            chosen = np.unravel_index(change.argmin(), change.shape)
            if change[chosen] >= 0:
                break
            side[list(set(chosen))] *= -1
        if (uneven := side @ shared @ side) < least:
            least, best = uneven, side > 0
    return best
