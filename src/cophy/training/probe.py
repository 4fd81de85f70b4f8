"""What U says about mass and friction: linear classifiers on the frozen estimate (paper Table 5)."""

from operator import itemgetter

import numpy as np
import torch
from torch import Tensor, nn

from cophy.training.metrics import over_objects
from cophy.types import Batch, map_fields, without_truth

MOST_VALUES = 1000  # more than any grid has of friction


def estimate(network: nn.Module, batch: Batch, *, batch_size: int) -> Tensor | None:
    """The estimate U (experiment, slot, hidden) of all experiments, or None if the network makes none."""
    parts = []
    with torch.no_grad():
        for start in range(0, len(batch.initial), batch_size):
            part = network.eval()(without_truth(map_fields(itemgetter(slice(start, start + batch_size)), batch)))
            if part.confounder_estimate is None:
                return None
            parts.append(part.confounder_estimate)
    return torch.cat(parts)


def probe(train: tuple[Tensor, Batch], test: tuple[Tensor, Batch]) -> dict[str, np.ndarray]:
    """(experiment,) share of objects of AB classified right: mass and friction together, each alone, and by chance.

    Logistic regressions, fitted on the estimates of the training split. `probe_chance` always answers the most
    frequent combination of the training split.
    """
    from sklearn.linear_model import LogisticRegression  # half a second to import, that no training waits for
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    fitted, tested = (u[batch.observed_presence].numpy() for u, batch in (train, test))
    seen, asked = (_classes(batch) for _, batch in (train, test))

    def per_experiment(right: np.ndarray) -> np.ndarray:
        scattered = torch.zeros(test[1].observed_presence.shape, dtype=torch.float64)
        scattered[test[1].observed_presence] = torch.from_numpy(right.astype(np.float64))
        return over_objects(scattered, test[1].observed_presence).numpy()

    def accuracy(name: str) -> np.ndarray:
        values = np.unique(seen[name])
        if len(values) == 1:  # a confounder that is a constant
            return per_experiment(asked[name] == values[0])
        classifier = make_pipeline(StandardScaler(), LogisticRegression(max_iter=1000))
        return per_experiment(classifier.fit(fitted, seen[name]).predict(tested) == asked[name])

    values, counts = np.unique(seen["mass and friction"], return_counts=True)
    most_frequent = values[counts.argmax()]
    return {
        "probe_accuracy": accuracy("mass and friction"),
        "probe_mass_accuracy": accuracy("mass"),
        "probe_friction_accuracy": accuracy("friction"),
        "probe_chance": per_experiment(asked["mass and friction"] == most_frequent),
    }


def _classes(batch: Batch) -> dict[str, np.ndarray]:
    mass, friction = batch.confounder_class[batch.observed_presence].numpy().T
    return {"mass": mass, "friction": friction, "mass and friction": mass * MOST_VALUES + friction}
