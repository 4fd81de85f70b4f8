"""Rendering and training steps on a GPU: models, batch sizes, precision, torch.compile, CUDA graphs; the paper's de-renderer.

Training has random inputs without empty slots; a step is forward, backward and Adam. Each result is written as it comes, so
ten minutes are enough.
"""

import math
import time
from collections.abc import Callable, Iterator
from functools import partial
from itertools import product

import numpy as np
import torch
from measure import REPEATS, Measured
from speed_training import Kind, random_batch
from torch import nn
from torch.profiler import ProfilerActivity, profile

from cophy.config import composed, settings, to_plain
from cophy.errors import CophyError
from cophy.models.derenderer import Derenderer
from cophy.models.layers import pack
from cophy.scenario import Shape, Simulator
from cophy.scenario.rendering import Backend, Renderer
from cophy.training.checkpoints import build_network
from cophy.training.losses import position_loss, stability_loss
from cophy.types import Batch, Inputs, Prediction, map_tensors

MODELS = ("cophynet", "alongside", "gns", "transformer")
BALLS = Kind(4, 4)
BATCH_SIZES = (64, 512, 4096)
SECONDS = 0.3  # at least, of each of REPEATS measurements
CPU_BATCH_SIZE = 64
DERENDERER_BATCHES = (32, 128, 256)
RESOLUTION = 224  # the paper's
RENDERED = (112, 224, 448)  # pixels
NUM_RENDERED = 5  # frames at once
FAINT = 8  # a difference of a channel, of 255, that nobody sees


def measure(device: str = "cuda") -> Iterator[Measured]:
    """Yield experiments/s of every combination, the share of the time in which kernels run, and frames/s of the de-renderer."""
    if device == "cuda" and not torch.cuda.is_available():
        raise SystemExit("just bench gpu: PyTorch finds no GPU with CUDA here")
    name = torch.cuda.get_device_name() if device == "cuda" else "CPU"
    yield from renderers(name)
    for model in MODELS:  # what the GPU is compared with; bench.py allows one thread
        step = prepared(model, random_batch(CPU_BATCH_SIZE, *BALLS), "float32", "eager")
        values = [CPU_BATCH_SIZE * each for each in rates(step, "cpu")]
        yield Measured(
            f"CPU, one thread: {model}, four balls, batch {CPU_BATCH_SIZE}, float32", "experiments/s", values
        )
    ways = [*product(BATCH_SIZES, MODELS, ("float32", "bfloat16"), ("eager", "graph"))]
    compiled = [(512, model, "float32", "compiled") for model in MODELS]  # last: compiling takes minutes
    for size, model, precision, how in (*ways, *compiled):
        batch = map_tensors(lambda tensor: tensor.to(device), random_batch(size, *BALLS))
        what = f"{name}: {model}, four balls, batch {size}, {precision}, {how}"
        try:
            step = prepared(model, batch, precision, how)
            yield Measured(what, "experiments/s", [size * each for each in rates(step, device)])
            if how == "eager":
                yield Measured(what, "time in kernels ÷ time", [share_in_kernels(step, device)])
        except RuntimeError as error:  # a result, too: this way does not work
            yield Measured(f"{what}: {str(error).splitlines()[0][:80]}", "experiments/s", [math.nan])
        if (size, model, precision, how) == ways[-1]:
            yield from derenderers(name, device)


def renderers(name: str) -> Iterator[Measured]:
    """Yield frames/s of both renderers, and the share of pixels by which their images differ."""
    scenario = settings("generate", "scenario=blocktower").scenario
    with Simulator() as simulator:
        tower = scenario.twin_pair(3, data_seed=0, pair=0, simulator=simulator)[0].observed
    positions, quaternions = np.split(tower.states[:NUM_RENDERED, :, :7], [3], axis=-1)
    boxes = [Shape.BOX] * scenario.num_slots

    def rendered(renderer: Renderer) -> np.ndarray:
        return renderer.render(positions, quaternions, presence=tower.presence, shapes=boxes, background_seed=0).rgb

    for resolution in RENDERED:
        images = []
        for backend in Backend:
            what = f"{name}: render.backend={backend.value}, towers, {resolution} px"
            try:
                with Renderer(scenario, resolution, backend) as renderer:
                    images.append(rendered(renderer).astype(int))
                    values = [NUM_RENDERED * each for each in rates(partial(rendered, renderer), "cpu")]
                yield Measured(what, "frames/s", values)
            except CophyError as error:  # no EGL here
                yield Measured(f"{what}: {error}", "frames/s", [math.nan])
        if len(images) == len(Backend):
            differs = np.abs(images[0] - images[1]).max(axis=-1) > FAINT
            yield Measured(f"{name}: pixels that differ visibly, towers, {resolution} px", "share", [differs.mean()])


def derenderers(name: str, device: str) -> Iterator[Measured]:
    """Yield the frames/s of the paper's de-renderer."""
    for size, precision in product(DERENDERER_BATCHES, ("float32", "bfloat16")):
        values = [size * each for each in rates(derenderer_step(size, precision, device), device)]
        yield Measured(
            f"{name}: the paper's de-renderer, {RESOLUTION} px, batch {size}, {precision}", "frames/s", values
        )


def prepared(model: str, batch: Batch, precision: str, how: str) -> Callable[[], None]:
    """Return a training step on one batch: eager, with a compiled network, or replayed as one CUDA graph."""
    torch.manual_seed(0)
    network = build_network(to_plain(composed("train", "scenario=balls", f"model={model}").model))
    device = batch.inputs.initial.device
    network.to(device)
    predict: Callable[[Inputs], Prediction] = network._predict  # type: ignore[assignment]  # as packing waits for the device
    inputs, _ = pack(batch.inputs)
    optimizer = torch.optim.Adam(network.parameters(), capturable=how == "graph")
    if how == "compiled":
        predict = torch.compile(predict)

    def step() -> None:
        with torch.autocast(device.type, torch.bfloat16, enabled=precision != "float32"):
            prediction = predict(inputs)
            loss = position_loss(prediction, batch.targets)
            if prediction.stable_logit is not None:
                loss = loss + stability_loss(prediction.stable_logit.float(), batch.targets)
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()

    return captured(step) if how == "graph" else step


def captured(step: Callable[[], None]) -> Callable[[], None]:
    """Return the replay of a CUDA graph of a step."""
    stream = torch.cuda.Stream()  # type: ignore[no-untyped-call]
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        for _ in range(3):  # allocates what a step needs
            step()
    torch.cuda.current_stream().wait_stream(stream)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        step()
    return graph.replay


def derenderer_step(size: int, precision: str, device: str) -> Callable[[], None]:
    """Return a training step of the de-renderer of the paper on random images."""
    torch.manual_seed(0)
    config = composed("train", "scenario=blocktower", "model=derenderer_paper", f"render.resolution={RESOLUTION}")
    network = build_network(to_plain(config.model)).to(device).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    assert isinstance(network, Derenderer)
    images = torch.rand(size, 3, RESOLUTION, RESOLUTION, device=device)
    optimizer = torch.optim.Adam(network.parameters())

    def step() -> None:
        with torch.autocast(device, torch.bfloat16, enabled=precision != "float32"):
            loss = sum_of_squares(network, images)
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()

    return step


def sum_of_squares(network: nn.Module, images: torch.Tensor) -> torch.Tensor:
    """Return a loss that every output takes part in."""
    outputs = [each for each in network(images) if isinstance(each, torch.Tensor)]
    return torch.stack([each.float().square().mean() for each in outputs]).sum()


def rates(step: Callable[[], object], device: str) -> list[float]:
    """Return the steps per second, REPEATS times."""
    for _ in range(3):
        step()
    return [rate(step, device) for _ in range(REPEATS)]


def rate(step: Callable[[], object], device: str) -> float:
    """Return the steps per second over at least SECONDS."""
    synchronize(device)
    start, count = time.perf_counter(), 0
    while time.perf_counter() - start < SECONDS:
        step()
        synchronize(device)
        count += 1
    return count / (time.perf_counter() - start)


def share_in_kernels(step: Callable[[], None], device: str) -> float:
    """Return the part of the time of a step in which kernels run on the GPU; the rest waits for the CPU to start them."""
    with profile(activities=[ProfilerActivity.CUDA if device == "cuda" else ProfilerActivity.CPU]) as profiled:
        start = time.perf_counter()
        step()
        synchronize(device)
        seconds = time.perf_counter() - start
    busy = sum(event.self_device_time_total for event in profiled.key_averages())
    return busy / 1e6 / seconds


def synchronize(device: str) -> None:
    """Wait until the device has finished."""
    if device == "cuda":
        torch.cuda.synchronize()
