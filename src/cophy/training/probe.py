"""The confounder probe: linear classifiers of mass and friction on the estimate U (paper Table 5)."""

import logging
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from cophy.training.metrics import over_objects
from cophy.types import Inputs, Targets, move_to, take

log = logging.getLogger(__name__)

MIN_SPREAD = 1e-4  # ours: U has a standard deviation of 0.15 and more over blocks, and of 6e-9 if its GRU is saturated


class Probed(NamedTuple):
    """Estimates of the confounders, and the truth about them."""

    estimate: Float[Tensor, "batch slots hidden"]
    targets: Targets


def collect_estimates(
    network: nn.Module, inputs: Inputs, *, batch_size: int
) -> Float[Tensor, "batch slots hidden"] | None:
    """Return the estimate U of all experiments, or None if the network has none."""
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
    """Warn that a training failed if U is the same for all objects, so that nothing of AB reaches the prediction.

    It happens when the inputs of the GRU over AB grow until it is saturated; then gradients vanish.
    """
    estimates = probed.estimate[probed.targets.observed_presence]
    if len(estimates) > 1 and estimates.std(dim=0).max() < MIN_SPREAD:
        log.warning(
            "the estimate U is the same for all objects, so D is predicted without AB: this training failed. Lower "
            "training.learning_rate, or try another seed; val/twin_difference_explained above 0 shows that AB is read"
        )


def probe(train: Probed, test: Probed) -> dict[str, np.ndarray]:
    """Classify mass and friction of the objects of AB by logistic regressions that are fitted on the training split.

    Returns:
        (experiment,) share of objects classified correctly: mass and friction together (`probe_accuracy`), each alone,
        and by always predicting the most frequent combination of the training split (`probe_chance`).
    """
    from sklearn.linear_model import LogisticRegression  # takes half a second to import
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    train_estimates, test_estimates = (
        each.estimate[each.targets.observed_presence].float().numpy() for each in (train, test)
    )
    train_classes, test_classes = (_classes(each.targets) for each in (train, test))

    def per_experiment(correct: np.ndarray) -> np.ndarray:
        presence = test.targets.observed_presence
        scattered = torch.zeros(presence.shape, dtype=torch.float64)
        scattered[presence] = torch.from_numpy(correct.astype(np.float64))
        return over_objects(scattered, presence).numpy()

    def accuracy(name: str) -> np.ndarray:
        values = np.unique(train_classes[name])
        if len(values) == 1:  # a confounder that is a constant
            return per_experiment(test_classes[name] == values[0])
        classifier = make_pipeline(StandardScaler(), LogisticRegression(max_iter=1000))
        classifier.fit(train_estimates, train_classes[name])
        return per_experiment(classifier.predict(test_estimates) == test_classes[name])

    values, counts = np.unique(train_classes["mass and friction"], return_counts=True)
    most_frequent = values[counts.argmax()]
    return {
        "probe_accuracy": accuracy("mass and friction"),
        "probe_mass_accuracy": accuracy("mass"),
        "probe_friction_accuracy": accuracy("friction"),
        "probe_chance": per_experiment(test_classes["mass and friction"] == most_frequent),
    }


def _classes(targets: Targets) -> dict[str, np.ndarray]:
    """Return (object,) classes of mass, of friction, and of both together."""
    classes = targets.confounder_class[targets.observed_presence].numpy()
    mass, friction = classes.T
    return {"mass": mass, "friction": friction, "mass and friction": mass * 1000 + friction}  # grids are smaller
