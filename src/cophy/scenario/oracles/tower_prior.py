"""How likely each combination of masses and gravity is in the data, given the towers A and C.

This is the conditional distribution of the search, its cells and twins included. All frictions are equally likely.

The search first draws a cell and both twins' configurations. Then it draws geometries until one fits. A geometry can fit
many pairs of configurations. Each pair contributes its own probability, divided by the share of all geometries that fit
that pair.
"""

import numpy as np

from cophy.scenario.blocktower import Blocktower
from cophy.scenario.search.settled import settled
from cophy.scenario.search.towers import TOWER_CELLS, TowerCell, Towers

MIN_PROPOSALS = 20_000  # open geometries that the shares are estimated from

_known: dict[tuple[str, str, int], "TowerPrior"] = {}


def tower_prior(scenario: Blocktower, kind: str, num_levels: int) -> "TowerPrior":
    """The prior, made once for each kind of do-operation and number of blocks (a few seconds).

    Args:
        scenario: whose data are meant.
        kind: of do-operation.
        num_levels: blocks in A.
    """
    key = (repr(scenario), kind, num_levels)
    if key not in _known:
        _known[key] = TowerPrior(scenario, kind, num_levels)
    return _known[key]


class TowerPrior:
    """P(masses, gravity | A, C) for one kind of do-operation and number of blocks."""

    def __init__(self, scenario: Blocktower, kind: str, num_levels: int) -> None:
        self._search = scenario.tower_search
        self._combinations = self._search.statics.combinations(num_levels)
        rng = np.random.default_rng((num_levels, scenario.do_operations.index(kind)))
        batches, count = [], 0
        while count < MIN_PROPOSALS:
            found = self._search.proposals(kind, num_levels, rng)
            batches.append(self._fits(found.towers))
            count += len(found.level)
        first, second = (np.concatenate([batch[twin] for batch in batches]) for twin in (0, 1))
        # (cell, combination of the first twin, of the second): how many geometries fit
        fitting = np.einsum("gci,gcj->cij", first, second, optimize=True)
        partners = np.maximum((fitting > 0).sum(axis=2, keepdims=True), 1)
        share_of_cell = np.bincount(np.concatenate(scenario.blocks()), minlength=len(TOWER_CELLS))
        self._pairs = share_of_cell[:, None, None] / (partners * np.maximum(fitting, 1))

    def __call__(self, towers: tuple[Towers, Towers]) -> np.ndarray:
        """(geometry, combination) probabilities, for towers A and C."""
        first, second = self._fits(towers)
        as_first = first * np.einsum("cij,gcj->gci", self._pairs, second)
        as_second = second * np.einsum("cij,gci->gcj", self._pairs, first)
        total = (as_first + as_second).sum(axis=1)
        return np.asarray(total / total.sum(axis=1, keepdims=True))

    def _fits(self, towers: tuple[Towers, Towers]) -> tuple[np.ndarray, np.ndarray]:
        """Under which combinations each geometry fits each cell, as the first twin and as the second.

        Both are (geometry, cell, combination), 1 where it fits.
        """
        statics = self._search.statics
        margins = np.stack([statics.margins(*tower, self._combinations) for tower in towers], axis=1)
        stands, falls = margins >= self._search.min_margin, margins <= -self._search.min_margin
        falls_from = statics.falls_from(*towers[0], self._combinations)
        kept = settled(falls_from, margins[:, 1] > 0, self._combinations)

        def fits(cell: TowerCell) -> np.ndarray:
            observed, counterfactual = ((stands if outcome else falls)[:, s] for s, outcome in enumerate(cell[:2]))
            return np.asarray(observed & counterfactual & kept)

        first = [fits(cell) for cell in TOWER_CELLS]
        second = [fits(cell.twin) for cell in TOWER_CELLS]
        return np.stack(first, axis=1).astype(np.float32), np.stack(second, axis=1).astype(np.float32)
