"""What each twin pair of a dataset must be: confounders, cell, do-operation; and which confounders † splits hold out.

Training, validation and test are balanced, each by construction. Consecutive pairs (of one half, where † splits hold out a
half) form a block, which shares one pair of confounder configurations and one kind of do-operation. A scenario has one or
several kinds of block, used in turn; each lists the cells of its pairs. In every block, both configurations have every
outcome equally often, so no value of a confounder predicts the outcome.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from cophy.errors import CophyError
from cophy.scenario.confounders import ConfounderGrid

MAX_ENUMERATED = 10_000  # with more configurations than this, they are sampled at random instead of enumerated
NUM_SAMPLED = 200  # then: the first twin's configuration and the candidates for the second
NUM_STARTS = 50  # ours: random starts of the search for balanced halves
MARGINAL_WEIGHT = 3  # ours: weight of the frequencies of single values relative to joint frequencies


@dataclass(frozen=True)
class PairAssignment:
    """What a twin pair must be.

    Attributes:
        first: Configuration of the first twin.
        seconds: Candidates for the configuration of the second twin, in the order in which to try them.
        do_operation: Index into the scenario's kinds of do-operations.
        cell: Index into the scenario's cells, for the first twin.
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
    series: int = 0,
) -> PairAssignment:
    """Return the assignment of a twin pair, a pure function of its index, the seed and the scenario.

    Where † splits hold out half of the configurations, both twins come from the same half, so that these splits keep
    twins together. Pairs alternate between the halves.

    Args:
        pair: Index of the twin pair in its series.
        seen: (configuration,) bool, the half that † splits train on; None if they hold out nothing.
        blocks: Kinds of block, each with the cells of its pairs.
        series: Training, validation and test are one series each. Blocks of different series are independent, so that training
            tells nothing about what is assigned to a test pair.

    Raises:
        CophyError: There are too few configurations for twins that differ.
    """
    halves = [None] if seen is None else [np.flatnonzero(~seen), np.flatnonzero(seen)]
    half_index, turn, position = _place(pair, len(halves), len(blocks[0]))
    half = halves[half_index]
    count = num_configurations if half is None else len(half)
    if count < 2:
        raise CophyError(
            "scenario.confounders leave too few configurations for twins: give some confounder more values"
        )
    if count > MAX_ENUMERATED:
        rng = np.random.default_rng((data_seed, series, half_index, turn, 0xC2))
        indices = list(dict.fromkeys(rng.integers(count, size=NUM_SAMPLED).tolist()))
        first, *seconds = indices if half is None else half[indices].tolist()
    else:
        configurations = np.arange(num_configurations) if half is None else half
        first, *seconds = _enumerate(configurations, turn, (data_seed, series, half_index))
    period = math.lcm(
        len(blocks), num_do_operations
    )  # turns after which kinds of block and do-operation coincide again
    return PairAssignment(
        first=first,
        seconds=tuple(seconds),
        do_operation=(turn + turn // period) % num_do_operations,
        cell=blocks[turn % len(blocks)][position],
    )


def block_of(pair: np.ndarray, *, num_halves: int, pairs_per_block: int) -> np.ndarray:
    """Return the number of the block of each twin pair in its series, given the number of halves (1 without † splits)."""
    half, turn, _ = _place(pair, num_halves, pairs_per_block)
    return turn * num_halves + half


def _place(pair: Any, num_halves: int, pairs_per_block: int) -> tuple[Any, Any, Any]:
    """Return the half of a pair, the turn of its block in the half, and its position in the block. Halves alternate."""
    index, half = pair // num_halves, pair % num_halves
    return half, index // pairs_per_block, index % pairs_per_block


def _enumerate(configurations: np.ndarray, turn: int, seed: tuple[int, ...]) -> list[int]:
    """Return a configuration and all others in the order to try them; in every cycle, each is first once."""
    cycle, rank = divmod(turn, len(configurations))
    order = np.random.default_rng((*seed, cycle, 0xC0)).permutation(configurations)
    shift = 1 + int(np.random.default_rng((*seed, cycle, 0xC1)).integers(len(order) - 1))
    first = order[rank]
    seconds = np.roll(order, -(rank + shift))
    return [int(first), *seconds[seconds != first].tolist()]


def select_seen(grid: ConfounderGrid, num_objects: int, symmetries: np.ndarray, data_seed: int) -> np.ndarray:
    """Select the half of the tower configurations that † splits train on; they test on the other half (paper Table 2).

    Masses and horizontal gravity decide how a tower falls. Two combinations of them are the same problem if a symmetry
    (which augmentation uses) maps one gravity to the other, or if all masses differ by one factor. All configurations of
    a problem, with any friction, are in one half, so training never sees a held-out problem, rotated or not. Both halves
    contain every value as equally often as the grid allows.

    Args:
        grid: Values of the confounders.
        num_objects: Blocks of a tower.
        symmetries: (symmetry, 2, 2) matrices on horizontal gravity.

    Returns:
        (configuration,) bool.
    """
    values = (tuple(grid.mass), tuple(grid.gravity_x), tuple(grid.gravity_y))
    seen = _seen_combinations(values, num_objects, tuple(symmetries.ravel().tolist()), data_seed)
    return np.asarray(grid.expand(seen, num_objects) > 0)


def canonical_problems(mass: np.ndarray, gravity_xy: np.ndarray, symmetries: np.ndarray) -> np.ndarray:
    """Return for each combination of masses and gravity the representative of its problem (see `select_seen`).

    Args:
        mass: (combination, object) kg.
        gravity_xy: (combination, 2) m/s².
        symmetries: (symmetry, 2, 2) matrices on gravity.

    Returns:
        (combination, object + 2): masses relative to the largest, then gravity: of all its images under the symmetries, the
        last in sorted order.
    """
    images = np.einsum("sij,cj->csi", symmetries, gravity_xy)
    last = np.lexsort((images[..., 1], images[..., 0]), axis=1)[:, -1]
    relative_mass = mass / mass.max(axis=1, keepdims=True)
    return np.round(np.hstack([relative_mass, images[np.arange(len(images)), last]]), 6) + 0.0  # no -0


@lru_cache(maxsize=64)  # it is the same for every pair of a dataset
def _seen_combinations(
    values: tuple[tuple[float, ...], ...], num_objects: int, symmetries: tuple[float, ...], data_seed: int
) -> np.ndarray:
    """Return (combination,) 1 for seen combinations, else 0, in the order of `ConfounderGrid.masses_and_gravities`."""
    masses, gravity_x, gravity_y = map(list, values)
    grid = ConfounderGrid(masses, friction=[1], restitution=[0], gravity_x=gravity_x, gravity_y=gravity_y)
    mass, gravity = grid.masses_and_gravities(num_objects)
    problem = canonical_problems(mass, gravity, np.array(symmetries).reshape(-1, 2, 2))
    problem_index = _index_rows(problem)
    counts = np.zeros((problem_index.max() + 1, 0), dtype=np.int64)
    for weight, property_index in _balanced_properties(mass, gravity, problem):
        counts_of_property = np.zeros((len(counts), property_index.max() + 1), dtype=np.int64)
        np.add.at(counts_of_property, (problem_index, property_index), weight)
        counts = np.hstack([counts, counts_of_property])
    seen = _halve(counts, np.random.default_rng((data_seed, num_objects, 0x5EED)))
    return seen[problem_index].astype(float)


def _balanced_properties(mass: np.ndarray, gravity: np.ndarray, problem: np.ndarray) -> list[tuple[int, np.ndarray]]:
    """Return weight and (combination,) index of each property whose frequencies shall be equal in both halves."""
    num_objects = mass.shape[1]
    single = [gravity[:, :1], gravity[:, 1:], *(mass[:, [k]] for k in range(num_objects))]
    canonical_gravity = problem[:, num_objects:]
    joint = [problem[:, :num_objects], *(np.hstack([mass[:, [k]], canonical_gravity]) for k in range(num_objects))]
    weighted = [(MARGINAL_WEIGHT, rows) for rows in single] + [(1, rows) for rows in joint]
    return [(weight, _index_rows(rows)) for weight, rows in weighted]


def _index_rows(rows: np.ndarray) -> np.ndarray:
    """Return (row,) indices from 0 that are the same for equal rows."""
    return np.unique(rows, axis=0, return_inverse=True)[1].reshape(-1)


def _halve(counts: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Divide items between two sides so that each column has nearly the same sum on both.

    From random starts, the one or two items whose change of side helps most change it, until nothing helps.

    Args:
        counts: (item, column) integers.

    Returns:
        (item,) bool.
    """
    gram, smallest, best = counts @ counts.T, np.inf, np.zeros(len(counts), dtype=bool)
    for _ in range(NUM_STARTS):
        side = 2 * rng.integers(2, size=len(counts)) - 1
        while True:
            single = 4 * (np.diag(gram) - side * (gram @ side))
            change = single[:, None] + single + 8 * np.outer(side, side) * gram
            np.fill_diagonal(change, single)
            items = np.unravel_index(change.argmin(), change.shape)
            if change[items] >= 0:
                break
            side[list(set(items))] *= -1
        if (imbalance := side @ gram @ side) < smallest:
            smallest, best = imbalance, side > 0
    return best
