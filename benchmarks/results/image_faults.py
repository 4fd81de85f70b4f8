"""How often predict.py refuses right images, and how often it notices wrong ones:

    python benchmarks/results/image_faults.py checkpoints/collision_derenderer.ckpt [data_dir] [--split val] [--count 24]

Images are rendered from experiments of size=small at 112 × 112 pixels. Each fault changes AB, C or both. A refusal is an error
in one line, which is printed for the first experiment that has one.
"""

from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from cophy.config import settings
from cophy.dataset import generation
from cophy.dataset.source import generated_sets
from cophy.dataset.splits import SPLITS
from cophy.errors import CophyError
from cophy.scenario import Scenario
from cophy.scenario.rendering import Renderer
from cophy.schemas import SCENARIOS, register
from cophy.training.trained import TrainedDerenderer, see

RESOLUTION = 112
ALL = slice(None)
Slots = slice | np.ndarray
Images = tuple[np.ndarray, np.ndarray]  # AB (T, R, R, 3) and C (R, R, 3)


@dataclass
class Experiments:
    """Experiments of one scenario, and renderers with its camera and with two others."""

    scenario: Scenario
    arrays: dict[str, np.ndarray]
    rows: np.ndarray
    renderers: dict[str, Renderer]

    def images(self, row: int, *, camera: str = "own", ab: Slots = ALL, c: Slots = ALL, hide: str = "") -> Images:
        """Render AB and C; `ab` and `c` reorder the slots, and `hide` names a sequence that lacks an object."""
        stride = self.scenario.clock.states_per_frame
        rendered = []
        for sequence, (name, order) in enumerate((("AB", ab), ("C", c))):
            states = self.arrays["states"][row, sequence, :: stride if name == "AB" else 10**6][:, order]
            presence = self.arrays["presence"][row, sequence][order].copy()
            if name == hide:
                presence[np.flatnonzero(presence & self.arrays["presence"][row, 1][order])[0]] = False
            rendered.append(
                self.renderers[camera]
                .render(
                    states[..., :3],
                    states[..., 3:7],
                    presence=presence,
                    shapes=self.arrays["shape"][row][order].tolist(),
                    background_seed=int(self.arrays["background_seed"][row]),
                )
                .rgb
            )
        return rendered[0], rendered[1][0]


def load(name: str, data_dir: Path, split: str, count: int) -> Experiments:
    """Load experiments of the default split of a scenario."""
    chosen = settings("train", f"scenario={name}", "size=small")
    (states,) = generated_sets(
        chosen.scenario,
        replace(chosen.split, test=chosen.split.train),
        None,
        size=chosen.size,
        data_seed=0,
        data_dir=data_dir,
    )
    generation.ensure(states, workers=2)
    arrays, scenario = states.load(), states.spec.scenario
    rows = np.flatnonzero(arrays["split"] == SPLITS.index(split))[:count]
    x, y, z = scenario.camera.eye
    eyes = {"own": [x, y, z], "farther": [1.5 * x, 1.5 * y, 1.5 * z], "turned": [-0.5 * y, 0.87 * y, z]}
    renderers = {
        each: Renderer(replace(scenario, camera=replace(scenario.camera, eye=eye)), RESOLUTION)
        for each, eye in eyes.items()
    }
    return Experiments(scenario, arrays, rows, renderers)


def faults(own: Experiments, others: list[Experiments], rng: np.random.Generator) -> dict[str, Callable[[int], Images]]:
    """Return functions of a row that give right images, and wrong ones of several kinds."""

    def exchanged(row: int, *, absent: bool) -> np.ndarray:
        """An order of slots that exchanges an object of C with another one, or with a colour that is absent."""
        presence = own.arrays["presence"][row]
        first, second = np.flatnonzero(presence[1])[:2]
        order = np.arange(len(presence[0]))
        other = np.flatnonzero(~presence[0])[0] if absent else second
        order[[first, other]] = order[[other, first]]
        return order

    def of(other: Experiments, row: int) -> Images:
        frames, initial = other.images(int(other.rows[row % len(other.rows)]))
        return np.resize(frames, (own.scenario.clock.num_frames, *frames.shape[1:])), initial

    def noisy(row: int, deviation: float) -> Images:
        return tuple(
            np.clip(image + rng.normal(0, deviation, image.shape), 0, 255).astype(np.uint8) for image in own.images(row)
        )  # type: ignore[return-value]

    return {
        "right images": own.images,
        **{f"images of {other.scenario.name}": partial(of, other) for other in others},
        "noise of 60 of 255": lambda row: noisy(row, 60),
        "an object is missing in AB": lambda row: own.images(row, hide="AB"),
        "an object is missing in C": lambda row: own.images(row, hide="C"),
        "an object of C in a colour that AB lacks": lambda row: own.images(row, c=exchanged(row, absent=True)),
        "two objects of C exchange colours": lambda row: own.images(row, c=exchanged(row, absent=False)),
        "C of another experiment": lambda row: (own.images(row)[0], own.images(int(own.rows[0]))[1]),
        "camera 1.5 times as far": lambda row: own.images(row, camera="farther"),
        "camera turned by 30°": lambda row: own.images(row, camera="turned"),
    }


def main(checkpoint: Path, data_dir: Path, split: str, count: int) -> None:
    """Print a line for each kind of images."""
    register()
    derenderer = TrainedDerenderer(checkpoint)
    own = load(derenderer.scenario, data_dir, split, count)
    others = [load(name, data_dir, split, 4) for name in SCENARIOS if name != derenderer.scenario]
    for name, make in faults(own, others, np.random.default_rng(0)).items():
        refusals, distances, sizes = [], [], []
        for row in own.rows.tolist():
            try:
                _, *evidence = see(*make(row), derenderer, own.scenario)
                distances += [each.distance_m for each in evidence]
                sizes += [each.apparent_size for each in evidence]
            except CophyError as error:
                refusals.append(str(error))
        print(
            f"{name}: {len(refusals)} of {len(own.rows)} refused" + "".join(f"; e.g. {each}" for each in refusals[:1])
        )
        if name == "right images" and distances:
            print(
                f"  largest reprojection error {np.nanmax(distances):.2f} m, sizes {np.nanmin(sizes):.2f} to {np.nanmax(sizes):.2f}"
            )


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("data_dir", type=Path, nargs="?", default=Path("data"))
    parser.add_argument("--split", choices=SPLITS, default="test")
    parser.add_argument("--count", type=int, default=24)
    main(**vars(parser.parse_args()))
