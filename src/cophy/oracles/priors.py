"""Initial velocities that bring the first frames of AB about, under any confounders: a fit through the simulator.

What is said where an oracle is asked about a scenario that it does not know.
How likely each configuration of confounders is in the data, given A, C and the do-operation.
How likely each combination of masses and gravity is in the data, given the towers A and C.

This is the conditional distribution of the search, its cells and twins included. All frictions are equally likely.

The search first draws a cell and both twins' configurations. Then it draws geometries until one fits. A geometry can fit
many pairs of configurations. Each pair contributes its own probability, divided by the share of all geometries that fit
that pair.
Initial velocities of A's objects, which its picture does not show: drawn as the scenario draws them, or inferred from AB.
"""

from collections.abc import Callable
from functools import singledispatch

import numpy as np

from cophy.errors import CophyError
from cophy.scenario.balls import Balls
from cophy.scenario.blocktower import Blocktower
from cophy.scenario.collision import Collision
from cophy.scenario.experiment import DoOperation
from cophy.scenario.physics import Clock, Scene, Solver
from cophy.scenario.scenario import Scenario
from cophy.scenario.search import SimulatedSearch
from cophy.scenario.simulator import Simulator
from cophy.scenario.towers import TOWER_CELLS, TowerCell, Towers, is_identifiable, read_tower


def unknown_scenario(scenario: Scenario) -> CophyError:
    """The error that names the scenario and the remedy."""
    return CophyError(
        f"the oracles do not know scenario={scenario.name}: leave out model=oracle_*, or register "
        f"{type(scenario).__name__} in cophy.scenario.oracles"
    )


@singledispatch
def configuration_prior(scenario: Scenario, scene: Scene, do_operation: DoOperation) -> np.ndarray:
    """The prior of the oracles.

    Args:
        scenario: whose data are meant.
        scene: A; its confounders and velocities do not matter.
        do_operation: what makes C of A.

    Returns:
        (configuration,) probabilities.
    """
    raise unknown_scenario(scenario)


@configuration_prior.register
def _of_towers(scenario: Blocktower, scene: Scene, do_operation: DoOperation) -> np.ndarray:
    num_levels = len(scene.objects)
    towers = read_tower(scene), read_tower(do_operation.apply(scene))
    probability = tower_prior(scenario, do_operation.kind, num_levels)(towers)[0]
    return scenario.confounders.expand(probability, num_levels)


@configuration_prior.register
def _uniform(scenario: SimulatedSearch, scene: Scene, do_operation: DoOperation) -> np.ndarray:
    count = scenario.confounders.num_configurations(len(scene.objects))
    return np.full(count, 1 / count)


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
            found = self._search.propose(kind, num_levels, rng)
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
        kept = is_identifiable(falls_from, margins[:, 1] > 0, self._combinations)

        def fits(cell: TowerCell) -> np.ndarray:
            observed, counterfactual = ((stands if outcome else falls)[:, s] for s, outcome in enumerate(cell[:2]))
            return np.asarray(observed & counterfactual & kept)

        first = [fits(cell) for cell in TOWER_CELLS]
        second = [fits(cell.twin) for cell in TOWER_CELLS]
        return np.stack(first, axis=1).astype(np.float32), np.stack(second, axis=1).astype(np.float32)


@singledispatch
def draw_initial_velocities(scenario: Scenario, scene: Scene, rng: np.random.Generator) -> np.ndarray:
    """Initial velocities as the scenario would draw them for objects that lie as in this scene.

    Args:
        scenario: whose objects they are.
        scene: A; its confounders and velocities do not matter.
        rng: they are drawn from it.

    Returns:
        (object, 2) horizontal velocities, m/s.
    """
    raise unknown_scenario(scenario)


@draw_initial_velocities.register
def _of_balls(scenario: Balls, scene: Scene, rng: np.random.Generator) -> np.ndarray:
    return scenario.sample_velocities(len(scene.objects), rng)


@draw_initial_velocities.register
def _of_collision(scenario: Collision, scene: Scene, rng: np.random.Generator) -> np.ndarray:
    """All start alike, so A tells it."""
    return scenario.initial_velocities(scene)


@singledispatch
def velocity_inference(
    scenario: Scenario, scene: Scene, observed: np.ndarray, simulator: Simulator
) -> Callable[[Scene], Scene]:
    """How A moves at t = 0, inferred from AB.

    Args:
        scenario: whose objects they are.
        scene: A with its true velocities, from which a fit may start; its confounders do not matter.
        observed: (T, K, 3) positions of AB at the frame rate, metres.
        simulator: fits are simulated with it.

    Returns:
        A function from A under any confounders to A as it must have moved under these.
    """
    raise unknown_scenario(scenario)


@velocity_inference.register
def _at_rest(
    scenario: Blocktower, scene: Scene, observed: np.ndarray, simulator: Simulator
) -> Callable[[Scene], Scene]:
    return lambda scene: scene


@velocity_inference.register
def _fitted(
    scenario: SimulatedSearch, scene: Scene, observed: np.ndarray, simulator: Simulator
) -> Callable[[Scene], Scene]:
    velocity = np.array([body.linear_velocity[:2] for body in scene.objects])
    return InitialVelocityFit(observed, velocity, solver=scenario.solver, clock=scenario.clock, simulator=simulator)


NEAR_M = 3e-3  # what is as near to where it is seen needs no correction; what a simulation remembers of the one before matters less
MAX_CORRECTIONS = 4  # in free motion each is exact but for friction
MAX_STEP = 2.0  # m/s, of a correction
TINY = 1e-12  # what may not be divided by


class InitialVelocityFit:
    """Finds initial velocities that bring the objects of a scene to where AB shows them in the second frame.

    It starts from the true initial velocities. So the fit under the true confounders is exact, as that of an endless search
    would be. From AB alone that search is hard: where something is hit before the second frame, few starts lead to the
    truth. Under other confounders the velocities are corrected by Broyden's method: every step also corrects the derivative
    that the next one uses.

    Args:
        observed: (T, K, 3) positions of AB at the frame rate, metres.
        velocity: (object, 2) true initial velocities, m/s.
        solver, clock: of the scenario.
        simulator: fits are simulated with it.
    """

    def __init__(
        self, observed: np.ndarray, velocity: np.ndarray, *, solver: Solver, clock: Clock, simulator: Simulator
    ) -> None:
        self.observed, self.velocity, self.solver, self.simulator = observed, velocity, solver, simulator
        self.rate = clock.frame_rate_hz

    def __call__(self, scene: Scene) -> Scene:
        """The scene with the best velocities on the way to those that reach the second frame."""
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
        """(2 objects,) simulated minus seen positions in the second frame, m."""
        simulated = self.simulator.simulate_from(scene, velocity, frames=1, solver=self.solver, frame_rate_hz=self.rate)
        slots = [body.slot for body in scene.objects if body.slot is not None]
        return np.asarray(simulated[0, :, :2] - self.observed[1, slots, :2]).ravel()
