"""Times training steps of a checkout, as compare_checkouts.py asks: python benchmarks/checkouts/checkout_steps.py CHECKOUT.

It says `ready`. Then a line `slots objects batch_size steps` on stdin asks for so many training steps, and a line on stdout
tells their CPU-seconds.
Everything is imported from the checkout, this file apart.
"""

import functools
import importlib
import sys
import time
from pathlib import Path
from typing import Any

import torch

REGISTRATIONS = ("cophy.schemas", "cophy.config")  # the module's name now, and before


def main(checkout: Path) -> None:
    """Answer until stdin ends."""
    sys.path[0:1] = [str(checkout / "src"), str(checkout / "benchmarks")]  # in place of this file's own folder
    torch.set_num_threads(1)
    registration().register()
    training = importlib.import_module("speed_training")
    model, batch_of = training.network(), functools.cache(training.random_batch)
    step = training.training_step(model, model)
    print("ready", flush=True)
    for line in sys.stdin:
        slots, objects, size, steps = map(int, line.split())
        batch = batch_of(size, slots, objects)
        start = time.process_time()
        for _ in range(steps):
            step(batch)
        print(time.process_time() - start, flush=True)


def registration() -> Any:
    """The checkout's module that makes its schemas known to Hydra."""
    now, before = REGISTRATIONS
    try:
        return importlib.import_module(now)
    except ModuleNotFoundError:
        return importlib.import_module(before)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
