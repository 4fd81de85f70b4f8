"""Which configurations of confounders explain AB: all are tried where that can be afforded, else the likeliest are looked for."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cophy.scenario.physics.scene import Scene
from cophy.scenario.physics.simulator import Simulator
from cophy.scenario.scenario import Scenario

FIRST_SHARES = (0.2, 0.3, 0.5)  # of AB's frames, which are compared before all of them
MAX_LOG_RATIO = 30.0  # to the most likely one; what is behind by more after the first frames is given up
NUM_GROUPED = 2  # for so many of these shares, one configuration stands for all that hardly differ from it
MAX_GROUP_LOG_RATIO = (
    4 * MAX_LOG_RATIO
)  # it is given up where it is behind by more; of the others some may be more likely
NEGLIGIBLE_LOG_RATIO = float(np.log(100))  # to the most likely one; what is behind by more does not change a mean


@dataclass(frozen=True)
class Explanation:
    """A configuration that may explain AB.

    scene: A under the configuration, with the initial velocities that fit it best. log_probability: not normalised.
    """

    scene: Scene
    log_probability: float


class ConfigurationSearch:
    """Compares AB with simulations under configurations.

    AB is compared with ever more of its frames. A configuration that the first ones speak against is not simulated further.

    Args:
        scenario: whose configurations they are.
        at_rest: A without velocities; its confounders do not matter.
        observed: (T, K, 3) positions of AB at the frame rate, metres.
        prior: (configuration,) probabilities.
        noise: standard deviation of every observed coordinate, metres.
        with_velocities: from A under some confounders to A as it must have moved under these.
        simulator: AB is simulated with it.
    """

    def __init__(
        self,
        scenario: Scenario,
        at_rest: Scene,
        observed: np.ndarray,
        prior: np.ndarray,
        *,
        noise: float,
        with_velocities: Callable[[Scene], Scene],
        simulator: Simulator,
    ) -> None:
        self.scenario, self.at_rest, self.observed, self.prior = scenario, at_rest, observed, prior
        self.noise, self.with_velocities, self.simulator = noise, with_velocities, simulator
        self._scene: dict[int, Scene] = {}
        num_frames = scenario.clock.num_frames
        self._lengths = [*(max(2, round(share * num_frames)) for share in FIRST_SHARES), num_frames]

    def alike_at_first(self, configurations: Iterable[int]) -> list[list[int]]:
        """Groups of configurations. Whether and where towers topple is up to masses and gravity; friction shows later."""
        groups = dict[Any, list[int]]()
        for configuration in configurations:
            truth = self.scenario.confounders.decode(configuration, len(self.at_rest.objects))
            key = configuration if self.scenario.statics is None else (truth.mass, truth.gravity_xy)
            groups.setdefault(key, []).append(configuration)
        return list(groups.values())

    def enumerated(self, groups: list[list[int]]) -> list[Explanation]:
        """The posterior over all these configurations.

        Args:
            groups: those that hardly differ at first. One stands for all in the first frames, and in all frames of a tower that stands.
        """
        group_of, stands = {group[0]: group for group in groups}, self._tower_stands()
        kept = list(group_of)
        for num_frames in self._lengths if stands else self._lengths[:NUM_GROUPED]:
            tried = self._tried(kept, num_frames)
            kept = self._within(tried, MAX_GROUP_LOG_RATIO)
        kept = [configuration for first in kept for configuration in group_of[first]]
        if stands:
            return self._explanations({c: tried[first] for first in tried for c in group_of[first]})
        for num_frames in self._lengths[NUM_GROUPED - 1 :]:
            tried = self._tried(kept, num_frames)
            kept = self._within(tried, MAX_LOG_RATIO)
        return self._explanations(tried)

    def _tower_stands(self) -> bool:
        """Whether AB is that of a tower which does not fall."""
        statics = self.scenario.statics
        moved = np.linalg.norm(self.observed - self.observed[0], axis=-1).max()
        return statics is not None and bool(moved < statics.fallen_distance)

    def searched(self, start: Iterable[int], max_configurations: int) -> list[Explanation]:
        """The posterior over the configurations that a search comes across.

        Args:
            start: where it starts.
            max_configurations: how many are tried, over all numbers of frames.
        """
        kept, at_once = list(start), -(-max_configurations // len(self._lengths))
        for num_frames in self._lengths:
            tried = self._tried(kept[:at_once], num_frames)
            self._climb(tried, num_frames, at_once)
            kept = self._within(tried, MAX_LOG_RATIO)
        return self._explanations(tried)

    def _tried(self, configurations: Iterable[int], num_frames: int) -> dict[int, float]:
        return {c: self._log_probability(c, num_frames) for c in configurations}

    def _climb(self, tried: dict[int, float], num_frames: int, max_configurations: int) -> None:
        """Try the neighbours of the most likely ones, best first.

        It ends where the best explains AB and the neighbours of all that are nearly as likely were tried.
        """
        expanded = set[int]()
        while len(tried) < max_configurations:
            left = [c for c in tried if c not in expanded]
            chosen = max(left, key=tried.__getitem__, default=None)
            least = max(tried.values()) - NEGLIGIBLE_LOG_RATIO
            if chosen is None or (self._explained(tried) and tried[chosen] < least):
                return
            expanded.add(chosen)
            for near in self.scenario.confounders.neighbours(chosen, len(self.at_rest.objects)):
                if near not in tried and self.prior[near] > 0:
                    tried[near] = self._log_probability(near, num_frames)

    def _explained(self, tried: dict[int, float]) -> bool:
        """Whether the best explains AB so well that none can be far more likely."""
        return max(tried.values()) >= float(np.log(self.prior.max())) - NEGLIGIBLE_LOG_RATIO

    def _within(self, tried: dict[int, float], log_ratio: float) -> list[int]:
        """Those near the most likely one, which comes first."""
        least = max(tried.values()) - log_ratio
        return [c for c in sorted(tried, key=tried.__getitem__, reverse=True) if tried[c] >= least]

    def _explanations(self, tried: dict[int, float]) -> list[Explanation]:
        return [Explanation(self._moving(c), tried[c]) for c in self._within(tried, NEGLIGIBLE_LOG_RATIO)]

    def _moving(self, configuration: int) -> Scene:
        """A under a configuration, with the initial velocities that fit it best."""
        if configuration not in self._scene:
            self._scene[configuration] = self.with_velocities(self.scenario.under(configuration, self.at_rest))
        return self._scene[configuration]

    def _log_probability(self, configuration: int, num_frames: int) -> float:
        """Log of prior × likelihood of the first frames; errors of all objects, frames and coordinates are independent."""
        clock = replace(self.scenario.clock, num_frames=num_frames)
        simulated = self.simulator.simulate(
            self._moving(configuration), solver=self.scenario.solver, clock=clock, num_slots=self.scenario.num_slots
        )
        frames = simulated.positions[:: clock.states_per_frame]
        squared = np.square(frames - self.observed[:num_frames])[:, simulated.presence].sum()
        return float(np.log(self.prior[configuration]) - squared / (2 * self.noise**2))
