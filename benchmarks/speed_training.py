"""CoPhyNet's training step against the plain loop of the same maths (reference.py), and what Lightning adds to it."""

import logging
import tempfile
import warnings
from collections.abc import Callable

import lightning as L
import reference
import torch
from measure import Measured, composed, paired, settings
from omegaconf import OmegaConf

from cophy.dataset.counterfactual import CounterfactualDataset
from cophy.models.cophynet import CoPhyNet
from cophy.training.augmentation import symmetries_for
from cophy.training.losses import position_loss, stability_loss
from cophy.training.prediction import PredictionModule
from cophy.training.run import build_network
from cophy.types import CONFOUNDERS, Batch, Prediction

PLAIN_BATCH = 32
STEPS_PER_PLAIN_ONE = 4  # so that both of a pair take about as long
# what is trained on: slots, objects present, and what is to be reached at the plain loop's batch and at the default one
KINDS = {"towers, 3 of 4 slots": (4, 3, "≥ 3", "≥ 5"), "balls, 4 of 9 slots": (9, 4, "≥ 8", "≥ 12")}


def measure() -> list[Measured]:
    """Throughput of forward, backward and Adam, then of a whole epoch."""
    default = settings("train").training.batch_size
    rows = []
    for kind, (slots, objects, reach, reach_at_default) in KINDS.items():
        for size, goal in ((PLAIN_BATCH, reach), (default, reach_at_default), (512, "")):
            ratios = [size / PLAIN_BATCH * ratio for ratio in against_the_plain_loop(size, slots, objects)]
            rows.append(Measured(f"CoPhyNet, {kind}, batch {size}", "experiments/s ÷ plain loop's at 32", ratios, goal))
    rows.append(
        Measured("CoPhyNet, Lightning and metrics", "epoch ÷ its forward, backward, Adam", whole_epochs(default))
    )
    return rows


def network() -> CoPhyNet:
    """The model as conf/ has it."""
    torch.manual_seed(0)
    built = build_network(OmegaConf.to_container(composed("train").model, resolve=True, enum_to_str=True))
    assert isinstance(built, CoPhyNet)
    return built


def training_step(predict: Callable[[Batch], Prediction], model: CoPhyNet) -> Callable[[Batch], None]:
    """Forward, backward and Adam."""
    optimizer = torch.optim.Adam(model.parameters())

    def step(batch: Batch) -> None:
        prediction = predict(batch)
        assert prediction.stable_logit is not None
        loss = position_loss(prediction, batch) + stability_loss(prediction.stable_logit, batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()

    return step


def against_the_plain_loop(batch_size: int, slots: int, objects: int) -> list[float]:
    """CPU time of a step of the plain loop ÷ that of a step of `batch_size`."""
    model = network()
    plain = training_step(lambda batch: reference.predict(model, batch), model)
    fast = training_step(model, model)
    small, large = (random_batch(size, slots, objects) for size in (PLAIN_BATCH, batch_size))
    ratios = paired(lambda: plain(small), lambda: [fast(large) for _ in range(STEPS_PER_PLAIN_ONE)])
    return [STEPS_PER_PLAIN_ONE * ratio for ratio in ratios]


def whole_epochs(batch_size: int) -> list[float]:
    """CPU time of an epoch under Lightning, without validation, ÷ that of its bare steps."""
    chosen, model = settings("train"), network()
    data, step = CounterfactualDataset(random_batch(2800, 4, 3)), training_step(model, model)
    symmetries = symmetries_for(chosen.split.train, chosen.scenario)
    module = PredictionModule(model, chosen.training, chosen.scenario, symmetries, config={})
    logging.getLogger("lightning.pytorch").setLevel(logging.ERROR)
    warnings.filterwarnings("ignore", "You defined a `validation_step`")
    module.setup = lambda stage: None  # type: ignore[method-assign]

    def lightning() -> None:
        with tempfile.TemporaryDirectory() as directory:
            trainer = L.Trainer(
                max_epochs=1,
                logger=False,
                enable_checkpointing=False,
                enable_progress_bar=False,
                enable_model_summary=False,
                gradient_clip_val=chosen.trainer.gradient_clip_val,
                default_root_dir=directory,
            )
            trainer.fit(module, data.loader(batch_size, shuffle=True))

    def bare() -> None:
        for each in data.loader(batch_size, shuffle=True):
            step(each)

    return paired(lightning, bare)


def random_batch(size: int, slots: int, objects: int) -> Batch:
    """So many objects in each experiment, anywhere among the slots, thirty frames."""
    presence = torch.rand(size, slots).argsort(dim=1) < objects
    return Batch(
        observed=torch.randn(size, 30, slots, 3) * presence[:, None, :, None],
        observed_presence=presence,
        observed_stable=torch.rand(size, 29, slots) > 0.5,
        initial=torch.randn(size, slots, 3) * presence[..., None],
        presence=presence,
        confounders=torch.randn(size, slots, len(CONFOUNDERS)),
        confounder_class=torch.randint(0, 2, (size, slots, 2)),
        target=torch.randn(size, 29, slots, 3),
        target_initial=torch.randn(size, slots, 3),
        target_presence=presence,
        stable=torch.rand(size, 29, slots) > 0.5,
    )
