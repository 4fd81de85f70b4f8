"""The confounder probe: linear classifiers of mass and friction on the estimate U (paper Table 5)."""

import logging
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from cophy.scoring import mean_over_objects
from cophy.types import Inputs, Targets, move_to, take

log = logging.getLogger(__name__)

MIN_SPREAD = 1e-4  # ours: U has a standard deviation of 0.15 and more over blocks, and of 6e-9 if its GRU is saturated


class Probed(NamedTuple):
    """Estimates of the confounders, and the truth about them."""

    estimate: Float[Tensor, "batch slots hidden"]
    targets: Targets


def collect_estimates(network: nn.Module, inputs: Inputs, *, batch_size: int) -> Float[Tensor, "batch slots hidden"]:
    """Return the estimate U of all experiments, by a network that has one."""
    parts, weights = [], next(network.parameters(), torch.zeros(()))
    inputs = move_to(inputs, weights.device, weights.dtype)
    with torch.no_grad():
        for start in range(0, len(inputs), batch_size):
            part = network.eval()(take(inputs, slice(start, start + batch_size)))
            assert part.confounder_estimate is not None
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
        Classes of the test split, indices into the scenario's grid as int16, -1 where AB has no object: confounder_class
        (experiment, K, 2), the true mass and friction; probe_mass_and_friction (experiment, K, 2), predicted by one
        classifier of both; probe_mass and probe_friction (experiment, K), predicted alone. probe_most_frequent (2,): the most
        frequent mass and friction of the training split.
    """
    from sklearn.linear_model import LogisticRegression  # takes half a second to import
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    presence = test.targets.observed_presence.numpy()
    train_estimates, test_estimates = (
        each.estimate[each.targets.observed_presence].float().numpy() for each in (train, test)
    )
    train_classes = train.targets.confounder_class[train.targets.observed_presence].numpy()

    def per_slot(classes: np.ndarray) -> np.ndarray:
        scattered = np.full((*presence.shape, *classes.shape[1:]), -1, dtype=np.int16)
        scattered[presence] = classes
        return scattered

    def predict(classes: np.ndarray) -> np.ndarray:
        if len(np.unique(classes)) == 1:  # a confounder that is a constant
            return np.full(len(test_estimates), classes[0])
        classifier = make_pipeline(StandardScaler(), LogisticRegression(max_iter=1000))
        return np.asarray(classifier.fit(train_estimates, classes).predict(test_estimates))

    combinations, index, counts = np.unique(train_classes, axis=0, return_inverse=True, return_counts=True)
    return {
        "confounder_class": per_slot(test.targets.confounder_class.numpy()[presence]),
        "probe_mass_and_friction": per_slot(combinations[predict(index)]),
        "probe_mass": per_slot(predict(train_classes[:, 0])),
        "probe_friction": per_slot(predict(train_classes[:, 1])),
        "probe_most_frequent": combinations[counts.argmax()].astype(np.int16),
    }


def probe_accuracies(probed: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return (experiment,) shares of objects of AB that are classified correctly, from the classes that `probe` returns.

    Mass and friction together (`probe_accuracy`), each alone, and by always predicting the most frequent combination of the
    training split (`probe_chance`).
    """
    true = probed["confounder_class"]
    correct = {
        "probe_accuracy": (probed["probe_mass_and_friction"] == true).all(axis=-1),
        "probe_mass_accuracy": probed["probe_mass"] == true[..., 0],
        "probe_friction_accuracy": probed["probe_friction"] == true[..., 1],
        "probe_chance": (probed["probe_most_frequent"] == true).all(axis=-1),
    }
    return {name: mean_over_objects(each, true[..., 0] >= 0) for name, each in correct.items()}
