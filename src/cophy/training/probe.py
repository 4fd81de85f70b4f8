"""The confounder probe: what U says about mass and friction, by linear classifiers on it (paper Table 5)."""

import logging
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from cophy.training.metrics import over_objects
from cophy.types import Inputs, Targets, move_to, take

log = logging.getLogger(__name__)

MAX_VALUES = 1000  # more than any grid has of friction
SAME = 1e-4  # ours: U spreads by 0.15 and more over blocks, and by 6e-9 where its GRU is saturated


class Probed(NamedTuple):
    """Estimates of the confounders, and the truth about them."""

    estimate: Float[Tensor, "batch slots hidden"]
    targets: Targets


def estimate(network: nn.Module, inputs: Inputs, *, batch_size: int) -> Float[Tensor, "batch slots hidden"] | None:
    """The estimate U of all experiments.

    Args:
        network: From `Inputs` to `Prediction`.
        inputs: Any number of experiments.
        batch_size: How many of them at once.

    Returns:
        U, or None if the network makes none.
    """
    parts, weights = [], next(network.parameters(), torch.zeros(()))
    inputs = move_to(inputs, weights.device, weights.dtype)
    with torch.no_grad():
        for start in range(0, len(inputs), batch_size):
            part = network.eval()(take(inputs, slice(start, start + batch_size)))
            if part.confounder_estimate is None:
                return None
            parts.append(part.confounder_estimate)
    return torch.cat(parts)


def warn_if_constant(probed: Probed) -> None:
    """Say that a training failed: U is the same for all objects, so nothing of AB reaches the prediction.

    It happens where the features that go into the GRU over AB grow until it is saturated; gradients vanish then.
    """
    estimates = probed.estimate[probed.targets.observed_presence]
    if len(estimates) > 1 and estimates.std(dim=0).max() < SAME:
        log.warning(
            "the estimate U is the same for all objects, so D is predicted without AB: this training failed. Lower "
            "training.learning_rate, or try another seed; val/twin_difference_explained above 0 shows that AB is read"
        )


def probe(train: Probed, test: Probed) -> dict[str, np.ndarray]:
    """Ask logistic regressions, fitted on the training split, for mass and friction of the objects of AB.

    Returns:
        (experiment,) share of objects classified right: mass and friction together (`probe_accuracy`), each alone,
        and by always answering the most frequent combination of the training split (`probe_chance`).
    """
    from sklearn.linear_model import LogisticRegression  # half a second to import, that no training waits for
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    fitted, tested = (each.estimate[each.targets.observed_presence].float().numpy() for each in (train, test))
    seen, asked = (_classes(each.targets) for each in (train, test))

    def per_experiment(right: np.ndarray) -> np.ndarray:
        presence = test.targets.observed_presence
        scattered = torch.zeros(presence.shape, dtype=torch.float64)
        scattered[presence] = torch.from_numpy(right.astype(np.float64))
        return over_objects(scattered, presence).numpy()

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


def _classes(targets: Targets) -> dict[str, np.ndarray]:
    mass, friction = targets.confounder_class[targets.observed_presence].numpy().T
    return {"mass": mass, "friction": friction, "mass and friction": mass * MAX_VALUES + friction}
