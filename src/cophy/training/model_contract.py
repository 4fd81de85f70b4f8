"""What a network has to return. A model of one's own is easily wrong here, and tensors that broadcast hide it."""

from torch import Tensor, nn

from cophy.errors import CophyError
from cophy.types import Prediction, Targets

NOT_FINITE = "predicts what is not finite: lower training.learning_rate, or look for a division by zero in the model"


def estimate_dim(network: nn.Module) -> int:
    """Width of the estimate U that a network says it makes; 0 if it makes none."""
    return int(getattr(network, "estimate_dim", 0))


def check_shapes(prediction: Prediction, targets: Targets, network: nn.Module) -> None:
    """Compare what a network returned with what the targets ask for.

    Args:
        prediction: What it returned.
        targets: What it is judged by.
        network: Named in the error; its `estimate_dim`, if it has one, is the width of U.

    Raises:
        CophyError: A part is missing, or has another type or shape.
    """
    name, width = type(network).__name__, estimate_dim(network)
    if not isinstance(prediction, Prediction):
        raise CophyError(f"{name} returns {type(prediction).__name__}, not cophy.types.Prediction")
    size, steps, slots, _ = targets.position.shape
    estimate = prediction.confounder_estimate
    if estimate is None and width:
        raise CophyError(f"{name} has an estimate_dim, but returns no confounder_estimate")
    expected: list[tuple[str, Tensor | None, tuple[tuple[int, ...], ...]]] = [
        ("position", prediction.position, ((size, steps, slots, 3),)),
        ("stable_logit", prediction.stable_logit, ((size, steps, slots), (size, 1, slots))),
        ("confounder_estimate", estimate, ((size, slots, width or (0 if estimate is None else estimate.shape[-1])),)),
    ]
    for field, tensor, shapes in expected:
        if tensor is not None and (tuple(tensor.shape) not in shapes or not tensor.is_floating_point()):
            choices = " or ".join(map(str, shapes))
            raise CophyError(
                f"{name} returns {field} {tensor.dtype} of shape {tuple(tensor.shape)}, not floats of {choices} (cophy/types.py)"
            )
