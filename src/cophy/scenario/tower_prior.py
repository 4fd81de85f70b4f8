"""Which masses and gravity the search for towers gives a geometry: its own conditional distribution, strata and twins
included, friction apart (all frictions are as likely).

The search draws a cell and both twins' configurations first, and then geometries until one fits. So a geometry that fits many
pairs of configurations comes from each of them with the pair's own probability, over the share of all geometries that fit it.
"""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from cophy.scenario.blocktower import Blocktower, Towers

NUM_PROPOSALS = 20_000  # open geometries that the shares are estimated from


_known: dict[tuple[str, str, int], "TowerPrior"] = {}


def tower_prior(scenario: "Blocktower", kind: str, num_levels: int) -> "TowerPrior":
    """The prior, made once (a few seconds)."""
    key = (repr(scenario), kind, num_levels)
    if key not in _known:
        _known[key] = TowerPrior(scenario, kind, num_levels)
    return _known[key]


class TowerPrior:
    """P(masses, gravity | A, C) for one kind of do-operation and number of blocks."""

    def __init__(self, scenario: "Blocktower", kind: str, num_levels: int) -> None:
        self.scenario, self.configurations = scenario, scenario.combinations(num_levels)
        rng = np.random.default_rng((num_levels, scenario.do_operations.index(kind)))
        batches, count = [], 0
        while count < NUM_PROPOSALS:
            found = scenario.proposals(kind, num_levels, rng)
            batches.append(self._fits(found.towers))
            count += len(found.level)
        first, second = (np.concatenate([batch[twin] for batch in batches]) for twin in (0, 1))
        # (cell, combination of the first twin, of the second): how many geometries fit
        fitting = np.einsum("gci,gcj->cij", first, second, optimize=True)
        partners = np.maximum((fitting > 0).sum(axis=2, keepdims=True), 1)
        self.pairs = 1 / (partners * np.maximum(fitting, 1))

    def __call__(self, towers: "tuple[Towers, Towers]") -> np.ndarray:
        """(geometry, combination) probabilities, for towers A and C."""
        first, second = self._fits(towers)
        as_first = first * np.einsum("cij,gcj->gci", self.pairs, second)
        as_second = second * np.einsum("cij,gci->gcj", self.pairs, first)
        total = (as_first + as_second).sum(axis=1)
        return np.asarray(total / total.sum(axis=1, keepdims=True))

    def _fits(self, towers: "tuple[Towers, Towers]") -> tuple[np.ndarray, np.ndarray]:
        """Under which combinations each geometry fits each cell, (geometry, cell, combination): as first, and as second twin."""
        from cophy.scenario.blocktower import CELLS, outcome_kind

        scenario = self.scenario
        margins = np.stack([scenario.margins(t, self.configurations) for t in towers], axis=1)
        may = scenario.agreement(margins > 0) >= scenario.min_agreement
        stands, falls = margins >= scenario.min_margin, margins <= -scenario.min_margin

        def fits(cell: tuple[bool, bool], kind: int) -> np.ndarray:
            observed, counterfactual = ((stands if outcome else falls)[:, s] for s, outcome in enumerate(cell))
            return np.asarray(observed & counterfactual & may[:, kind, None])

        first = [fits(cell, outcome_kind(cell)) for cell in CELLS]
        second = [fits((not cell[0], not cell[1]), outcome_kind(cell)) for cell in CELLS]
        return np.stack(first, axis=1).astype(np.float32), np.stack(second, axis=1).astype(np.float32)
