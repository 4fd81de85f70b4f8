"""CoPhyNet's training step: batch sizes and precisions against each other, `alongside` against it, and what Lightning adds."""

import logging
import tempfile
import warnings
from collections.abc import Callable
from typing import NamedTuple

import lightning as L
import torch
from hydra.utils import instantiate
from measure import Measured, paired
from torch import nn
from torch.optim import Optimizer

from cophy.config import composed, settings, to_plain
from cophy.dataset.datamodules import CounterfactualDataset
from cophy.models.cophynet import CoPhyNet
from cophy.training.checkpoints import build_network
from cophy.training.losses import position_loss, stability_loss
from cophy.training.predictor import PredictionModule
from cophy.types import Batch, Inputs, Prediction, Targets, map_tensors

Step = Callable[[Batch], object]

BATCH_SIZES = (32, 512)  # besides the default
EXPERIMENTS_AT_ONCE = 512  # that one of a pair of runs trains on
EXPERIMENTS_PER_EPOCH = 2800  # the training split of size=small


class Kind(NamedTuple):
    """Numbers of slots and of objects of an experiment."""

    slots: int
    objects: int


MODELS = ("cophynet", "alongside")
KINDS = {"towers, 3 of 4 slots": Kind(4, 3), "balls, 4 of 9 slots": Kind(9, 4)}


def measure() -> list[Measured]:
    """Measure throughput by batch size, CPU time by precision, and a whole epoch."""
    default = settings("train").training.batch_size
    rows = []
    for name, kind in KINDS.items():
        for size in BATCH_SIZES:
            ratios = paired(training(default, kind), training(size, kind))
            rows.append(Measured(f"CoPhyNet, {name}, batch {size}", f"experiments/s ÷ that at {default}", ratios))
        for precision, ratios in precisions(default, kind).items():
            rows.append(Measured(f"CoPhyNet, {name}, {precision}", "CPU time ÷ that in float32", ratios))
        of_both = (repeated(training_step_of(model), random_batch(default, *kind)) for model in reversed(MODELS))
        rows.append(Measured(f"alongside, {name}, its own optimiser", "CPU time ÷ CoPhyNet's", paired(*of_both), "≤ 3"))
    lightning = Measured("CoPhyNet, Lightning and metrics", "epoch ÷ its bare steps", whole_epochs(default))
    return [*rows, lightning]


def network() -> CoPhyNet:
    """Build CoPhyNet as conf/ configures it."""
    torch.manual_seed(0)
    built = build_network(to_plain(composed("train").model))
    assert isinstance(built, CoPhyNet)
    return built


def training_step(
    predict: Callable[[Inputs], Prediction], model: nn.Module, optimiser: Callable[..., Optimizer] = torch.optim.Adam
) -> Step:
    """Return a training step: forward, backward and optimiser."""
    optimizer = optimiser(model.parameters())

    def step(batch: Batch) -> None:
        prediction = predict(batch.inputs)
        assert prediction.stable_logit is not None
        loss = position_loss(prediction, batch.targets) + stability_loss(prediction.stable_logit, batch.targets)
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()

    return step


def training_step_of(model: str) -> Step:
    """Return a training step of a model with the optimiser that conf/model/ chooses."""
    chosen = composed("train", f"model={model}")
    torch.manual_seed(0)
    built = build_network(to_plain(chosen.model))
    return training_step(built, built, instantiate(chosen.training.optimizer))


def training(size: int, kind: Kind) -> Callable[[], object]:
    """Return a function that trains on EXPERIMENTS_AT_ONCE experiments in batches of `size`."""
    model = network()
    return repeated(training_step(model, model), random_batch(size, *kind))


def repeated(step: Step, batch: Batch) -> Callable[[], object]:
    """Return a function that repeats the step until it has seen EXPERIMENTS_AT_ONCE experiments."""
    return lambda: [step(batch) for _ in range(EXPERIMENTS_AT_ONCE // len(batch))]


def precisions(size: int, kind: Kind) -> dict[str, list[float]]:
    """Measure the CPU time of a step in bfloat16 autocast and in float64 ÷ that in float32."""
    single, mixed, double = network(), network(), network().double()
    batch = random_batch(size, *kind)
    batch_in_double = map_tensors(lambda tensor: tensor.double() if tensor.is_floating_point() else tensor, batch)

    def predict_mixed(inputs: Inputs) -> Prediction:
        with torch.autocast("cpu", torch.bfloat16):
            prediction = mixed(inputs)
        assert isinstance(prediction, Prediction)
        return prediction

    in_single = repeated(training_step(single, single), batch)
    in_mixed = repeated(training_step(predict_mixed, mixed), batch)
    in_double = repeated(training_step(double, double), batch_in_double)
    return {"bfloat16 autocast": paired(in_mixed, in_single), "float64": paired(in_double, in_single)}


def whole_epochs(batch_size: int) -> list[float]:
    """CPU time of an epoch under Lightning, without validation, ÷ that of its bare steps."""
    model = network()
    data = CounterfactualDataset(random_batch(EXPERIMENTS_PER_EPOCH, *KINDS["towers, 3 of 4 slots"]))
    step = training_step(model, model, instantiate(settings("train").training.optimizer))
    module = lightning_module(model)
    logging.getLogger("lightning.pytorch").setLevel(logging.ERROR)
    for harmless in ("You defined a `validation_step`", ".*does not have many workers", ".*LeafSpec"):
        warnings.filterwarnings("ignore", harmless)

    def lightning() -> None:
        with tempfile.TemporaryDirectory() as directory:
            quiet_trainer(directory).fit(module, data.shuffled(batch_size))

    def bare() -> None:
        for each in data.shuffled(batch_size):
            step(each)

    return paired(lightning, bare)


def lightning_module(model: CoPhyNet) -> PredictionModule:
    """Build the LightningModule of a run on towers of three."""
    chosen = settings("train")
    return PredictionModule(model, chosen.training, chosen.scenario)


def quiet_trainer(directory: str) -> L.Trainer:
    """Build a trainer of one epoch that writes and shows nothing."""
    return L.Trainer(
        max_epochs=1,
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        gradient_clip_val=settings("train").trainer.gradient_clip_val,
        default_root_dir=directory,
    )


def random_batch(size: int, slots: int, objects: int) -> Batch:
    """Draw `size` random experiments of 30 frames, each with `objects` objects in random slots."""
    presence = torch.rand(size, slots).argsort(dim=1) < objects
    inputs = Inputs(
        observed=torch.randn(size, 30, slots, 3) * presence[:, None, :, None],
        observed_presence=presence,
        observed_stable=torch.rand(size, 29, slots) > 0.5,
        initial=torch.randn(size, slots, 3) * presence[..., None],
        presence=presence,
    )
    targets = Targets(
        position=torch.randn(size, 29, slots, 3),
        stable=torch.rand(size, 29, slots) > 0.5,
        presence=presence,
        initial=inputs.initial,
        observed_presence=presence,
        pair=torch.arange(size) // 2,
        cell=torch.zeros(size, dtype=torch.long),
        confounder_class=torch.randint(0, 2, (size, slots, 2)),
    )
    return Batch(inputs, targets)
