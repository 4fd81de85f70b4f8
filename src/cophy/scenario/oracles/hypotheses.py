"""What D could be, and how sure the mean of it is."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cophy.scenario.physics.scene import Trajectory


@dataclass(frozen=True)
class Hypotheses:
    """Possible D.

    counterfactuals: trajectories of D.
    weight: (hypothesis,) how likely each is; they sum to 1.
    draw: (hypothesis,) number of the independent draw that each came of. Twins come of one draw. None where nothing was drawn.
    """

    counterfactuals: list[Trajectory]
    weight: np.ndarray
    draw: np.ndarray | None = None

    @classmethod
    def drawn(cls, draws: list[list[Trajectory]]) -> "Hypotheses":
        """Those of independent draws, each of equally many trajectories."""
        draw = np.repeat(np.arange(len(draws)), [len(each) for each in draws])
        trajectories = [trajectory for each in draws for trajectory in each]
        return cls(trajectories, np.full(len(trajectories), 1 / len(trajectories)), draw)

    @cached_property
    def states(self) -> np.ndarray:
        """(hypothesis, time, slot, 13), see `Trajectory.states`."""
        return np.stack([trajectory.states for trajectory in self.counterfactuals])

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Mean of a value per hypothesis (first axis)."""
        return np.asarray(np.average(values, axis=0, weights=self.weight))

    def variance_of_mean(self, values: np.ndarray) -> np.ndarray:
        """Unbiased estimate of the variance that the mean owes to the draws; 0 where nothing was drawn.

        The draws are independent, so it is the variance between the means of draws, divided by their number.
        """
        if self.draw is None:
            return np.zeros(values.shape[1:])
        count = int(self.draw.max()) + 1
        of_draw = np.stack([values[self.draw == draw].mean(axis=0) for draw in range(count)])
        return np.asarray(of_draw.var(axis=0, ddof=1) / count)
