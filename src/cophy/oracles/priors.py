"""Prior of the oracles: confounders given A, C and the do-operation; initial velocities inferred from AB.

The prior of towers is the conditional distribution of the search, with its cells and twins; all frictions have the same
probability. The search first draws a cell and both twins' configurations, and then geometries until one fits. A geometry can
fit many pairs of configurations. The probability of each pair is that of drawing it, divided by the share of all
geometries that fit the pair.

Three differences from the search are ignored. Twins of towers come from one half of the combinations (seen or unseen), and never
differ in the mass of the lowest block alone. For balls and collisions all configurations have the same probability, although the
search prefers pairs that many initial velocities fit.
"""

from collections.abc import Callable

import numpy as np

from cophy.errors import CophyError
from cophy.scenario.blocktower import Blocktower
from cophy.scenario.experiment import DoOperation
from cophy.scenario.physics import Clock, Scene, Solver
from cophy.scenario.scenario import Scenario
from cophy.scenario.search import SimulatedSearch
from cophy.scenario.simulator import Simulator
from cophy.scenario.towers import TOWER_CELLS, TowerCell, Towers, is_identifiable, read_tower


def unknown_scenario(scenario: Scenario) -> CophyError:
    """Return the error for a scenario that the oracles do not know."""
    return CophyError(
        f"the oracles do not know scenario={scenario.name}: leave out model=oracle_*, or derive {type(scenario).__name__} from "
        "SimulatedSearch"
    )


def configuration_prior(scenario: Scenario, scene: Scene, do_operation: DoOperation) -> np.ndarray:
    """Return the probability of each configuration of confounders, given A, C and the do-operation.

    Args:
        scene: A; its confounders and velocities are not used.

    Returns:
        (configuration,) probabilities.
    """
    num_objects = len(scene.objects)
    if isinstance(scenario, Blocktower):
        towers = read_tower(scene), read_tower(do_operation.apply(scene))
        probability = tower_prior(scenario, do_operation.kind, num_objects)(towers)[0]
        return scenario.confounders.expand(probability, num_objects)
    if isinstance(scenario, SimulatedSearch):
        count = scenario.confounders.num_configurations(num_objects)
        return np.full(count, 1 / count)
    raise unknown_scenario(scenario)


MIN_PROPOSALS = 20_000  # geometries from which the shares are estimated

_tower_priors: dict[tuple[str, str, int], "TowerPrior"] = {}


def tower_prior(scenario: Blocktower, kind: str, num_levels: int) -> "TowerPrior":
    """Return the prior, which is computed once for each kind of do-operation and number of blocks in A (a few seconds)."""
    key = (repr(scenario), kind, num_levels)
    if key not in _tower_priors:
        _tower_priors[key] = TowerPrior(scenario, kind, num_levels)
    return _tower_priors[key]


class TowerPrior:
    """P(masses, gravity | A, C) for one kind of do-operation and number of blocks."""

    def __init__(self, scenario: Blocktower, kind: str, num_levels: int) -> None:
        self._scenario = scenario
        self._combinations = scenario.statics.combinations(num_levels)
        rng = np.random.default_rng((num_levels, scenario.do_operations.index(kind)))
        batches, count = [], 0
        while count < MIN_PROPOSALS:
            proposals = scenario.propose(kind, num_levels, rng)
            batches.append(self._fits(proposals.towers))
            count += len(proposals.level)
        first, second = (np.concatenate([batch[twin] for batch in batches]) for twin in (0, 1))
        # number of geometries that fit: (cell, combination of the first twin, combination of the second twin)
        fitting = np.einsum("gci,gcj->cij", first, second, optimize=True)
        partners = np.maximum((fitting > 0).sum(axis=2, keepdims=True), 1)
        share_of_cell = np.bincount(np.concatenate(scenario.blocks()), minlength=len(TOWER_CELLS))
        self._pairs = share_of_cell[:, None, None] / (partners * np.maximum(fitting, 1))

    def __call__(self, towers: tuple[Towers, Towers]) -> np.ndarray:
        """Return (geometry, combination) probabilities, for towers A and C."""
        first, second = self._fits(towers)
        as_first = first * np.einsum("cij,gcj->gci", self._pairs, second)
        as_second = second * np.einsum("cij,gci->gcj", self._pairs, first)
        total = (as_first + as_second).sum(axis=1)
        return np.asarray(total / total.sum(axis=1, keepdims=True))

    def _fits(self, towers: tuple[Towers, Towers]) -> tuple[np.ndarray, np.ndarray]:
        """Return whether each geometry fits each cell under each combination, as the first twin and as the second.

        Returns:
            Two arrays, (geometry, cell, combination), 1 where it fits.
        """
        statics = self._scenario.statics
        margins = np.stack([statics.margins(*tower, self._combinations) for tower in towers], axis=1)
        stands, falls = margins >= self._scenario.min_margin, margins <= -self._scenario.min_margin
        falls_from = statics.falls_from(*towers[0], self._combinations)
        identifiable = is_identifiable(falls_from, margins[:, 1] > 0, self._combinations)

        def fits(cell: TowerCell) -> np.ndarray:
            observed, counterfactual = ((stands if outcome else falls)[:, s] for s, outcome in enumerate(cell[:2]))
            return np.asarray(observed & counterfactual & identifiable)

        first = [fits(cell) for cell in TOWER_CELLS]
        second = [fits(cell.twin) for cell in TOWER_CELLS]
        return np.stack(first, axis=1).astype(np.float32), np.stack(second, axis=1).astype(np.float32)


def velocity_inference(
    scenario: Scenario, scene: Scene, observed: np.ndarray, simulator: Simulator
) -> Callable[[Scene], Scene]:
    """Return a function from A under any confounders to A with the initial velocities that fit AB under them.

    Args:
        scene: A with its true velocities, from which a fit may start; its confounders are not used.
        observed: (T, K, 3) positions of AB at the frame rate, metres.
    """
    if isinstance(scenario, Blocktower):  # towers start at rest
        return lambda scene: scene
    if isinstance(scenario, SimulatedSearch):
        velocity = np.array([body.linear_velocity[:2] for body in scene.objects])
        return InitialVelocityFit(observed, velocity, solver=scenario.solver, clock=scenario.clock, simulator=simulator)
    raise unknown_scenario(scenario)


NEAR_M = 3e-3  # a smaller position error needs no correction; the state that a simulation keeps from the previous one matters less
MAX_CORRECTIONS = 4  # in free motion each is exact except for friction
MAX_STEP = 2.0  # m/s, of one correction
TINY = 1e-12  # guards against division by zero


class InitialVelocityFit:
    """Fit of initial velocities that bring the objects of a scene to their positions in the second frame of AB.

    The fit starts from the true initial velocities, so that it is exact under the true confounders, as an exhaustive search
    would be. From AB alone that search is hard: where objects collide before the second frame, few starting points lead to
    the true velocities. Under other confounders the velocities are corrected by Broyden's method: every step also updates
    the derivative that the next step uses.

    Args:
        observed: (T, K, 3) positions of AB at the frame rate, metres.
        velocity: (object, 2) true initial velocities, m/s.
    """

    def __init__(
        self, observed: np.ndarray, velocity: np.ndarray, *, solver: Solver, clock: Clock, simulator: Simulator
    ) -> None:
        self.observed, self.velocity, self.solver, self.simulator = observed, velocity, solver, simulator
        self.rate = clock.frame_rate_hz

    def __call__(self, scene: Scene) -> Scene:
        """Return the scene with the velocities of the smallest error among those that were tried."""
        velocity = self.velocity
        inverse = self.rate * np.eye(velocity.size)  # velocities per position: that of free motion
        miss = self._miss(scene, velocity)
        best, least = velocity, float(np.abs(miss).max())
        for _ in range(MAX_CORRECTIONS):
            if least < NEAR_M:
                break
            step = np.clip(-inverse @ miss, -MAX_STEP, MAX_STEP)
            velocity = velocity + step.reshape(velocity.shape)
            change = self._miss(scene, velocity) - miss
            miss, moved = miss + change, inverse @ change
            if abs(scale := float(step @ moved)) > TINY:
                inverse = inverse + np.outer(step - moved, step @ inverse) / scale
            if float(np.abs(miss).max()) < least:
                best, least = velocity, float(np.abs(miss).max())
        return scene.with_velocities(best)

    def _miss(self, scene: Scene, velocity: np.ndarray) -> np.ndarray:
        """Return (2 objects,) simulated minus observed positions in the second frame, m."""
        simulated = self.simulator.simulate_from(scene, velocity, frames=1, solver=self.solver, frame_rate_hz=self.rate)
        slots = [body.slot for body in scene.objects if body.slot is not None]
        return np.asarray(simulated[0, :, :2] - self.observed[1, slots, :2]).ravel()
