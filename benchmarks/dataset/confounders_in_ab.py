"""What boosted trees read about the confounders off AB: python benchmarks/dataset/confounders_in_ab.py scenario=blocktower size=small

Takes what generate.py takes; the datasets must be there. A bound from below on what the probe of CoPhyNet's U (paper Table 5)
could find. All frames of AB are seen with independent Gaussian noise. Objects are asked for by one classifier, cross-validated
over twin pairs. Prints a Markdown table: the share that is read rightly, with 95 % intervals, and the share of the most frequent
answer. A alone tells something too: the search does not find every geometry under every configuration.
"""

from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Iterator

import numpy as np
import pandas as pd
from sklearn.ensemble import HistGradientBoostingClassifier
from sklearn.model_selection import GroupKFold
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from cophy.audit.data import slots_in_order
from cophy.bootstrap import interval
from cophy.config import generated_by, settings
from cophy.dataset.spec import DatasetSpec
from cophy.schemas import register

Arrays = dict[str, np.ndarray]

NOISE_M = {"1 cm": 0.01, "5 cm": 0.05}
NUM_FOLDS = 5
FRAMES = (
    1,
    2,
    3,
    4,
    5,
    6,
    8,
    10,
    14,
    20,
    29,
)  # after the first; later ones, and those that a short AB lacks, tell little
AROUND = 2  # frames before and after an impact over which velocities are measured: at 5 cm one frame is mostly noise


def main(*overrides: str) -> None:
    """Measure every dataset, then print."""
    register()
    found = pd.concat([table(states.load(), states.spec) for states in generated_by(settings("generate", *overrides))])
    print(found.to_markdown(index=False))


def table(arrays: Arrays, spec: DatasetSpec) -> pd.DataFrame:
    """A row per cell and confounder, a column per noise."""
    answers = true_answers(arrays, spec)
    right = {name: _read(positions(arrays, spec, noise), answers, arrays["twin"]) for name, noise in NOISE_M.items()}
    rows = []
    for cell, chosen in _cells(arrays, spec):
        for name, answer in answers.items():
            shares = {noise: _share(of[name][chosen], arrays["twin"][chosen]) for noise, of in right.items()}
            chance = {"chance": f"{_most_frequent(answer[chosen]):.0%}"}
            what = {"data": f"{spec.scenario.name}, {spec.num_objects}", "cell": cell, "experiments": chosen.sum()}
            rows.append({**what, "confounder": name, **shares, **chance})
    return pd.DataFrame(rows)


def true_answers(arrays: Arrays, spec: DatasetSpec) -> dict[str, np.ndarray]:
    """Per confounder that varies, the index of its value: (experiment, object), or for gravity (experiment, x or y)."""
    slots, grid = slots_in_order(arrays, spec.num_objects), spec.scenario.confounders
    found = {}
    for name in ("mass", "friction", "restitution"):
        values = np.array(getattr(grid, name))
        if len(values) > 1:
            found[name] = _nearest(np.take_along_axis(arrays[name], slots, axis=1), values)
    if {"mass", "friction"} <= found.keys():  # as the probe of Table 5 is asked
        found["mass and friction"] = found["mass"] * len(grid.friction) + found["friction"]
    if len(grid.gravity_x) > 1:
        along = enumerate((grid.gravity_x, grid.gravity_y))
        components = [_nearest(arrays["gravity"][:, axis], np.array(values)) for axis, values in along]
        found["gravity, x and y"] = np.stack(components, axis=1)
    return found


def positions(arrays: Arrays, spec: DatasetSpec, noise_m: float) -> np.ndarray:
    """(experiment, frame, object, 3) metres in AB, with noise; objects in the scenario's own order."""
    slots = slots_in_order(arrays, spec.num_objects)
    frames = arrays["states"][:, 0, :: spec.scenario.clock.states_per_frame, :, :3]
    seen = np.take_along_axis(frames, slots[:, None, :, None], axis=2).astype(np.float64)
    return np.asarray(seen + np.random.default_rng(0).normal(0, noise_m, seen.shape))


def features(position: np.ndarray, k: int) -> np.ndarray:
    """(experiment, feature): what object k did, where the others were and what they did, and its nearest encounter.

    position: (experiment, frame, object, 3) metres.
    """
    frames = [frame for frame in FRAMES if frame < position.shape[1]]
    others = [j for j in range(position.shape[2]) if j != k]
    since = position - position[:, :1]
    offset = position[:, :, others] - position[:, :, k : k + 1]
    parts = [
        np.full(len(position), k),  # where in a tower, or which of two that collide
        since[:, frames, k],
        np.linalg.norm(np.diff(position[:, :, k], axis=1), axis=-1),
        offset[:, 0],
        np.linalg.norm(offset, axis=-1)[:, frames],
        since[:, frames][:, :, others],
        *_encounter(position, k, others),
    ]
    return np.concatenate([part.reshape(len(position), -1) for part in parts], axis=1)


def _encounter(position: np.ndarray, k: int, others: list[int]) -> Iterator[np.ndarray]:
    """The two objects that come nearest, k among them: when, how near, and how both change their velocities (m per frame).

    Momentum is kept, so the ratio of both changes is the ratio of the masses.
    """
    rows, inner = np.arange(len(position)), slice(AROUND, position.shape[1] - AROUND)
    distance = np.linalg.norm(position[:, inner, others] - position[:, inner, k : k + 1], axis=-1)
    nearest = distance.reshape(len(position), -1).argmin(axis=1)
    time, other = np.unravel_index(nearest, distance.shape[1:])
    yield from (time, distance.reshape(len(position), -1)[rows, nearest])
    sizes = []
    for which in (np.full(len(position), k), np.array(others)[other]):
        before, at, after = (position[rows, time + AROUND + shift, which] for shift in (-AROUND, 0, AROUND))
        sizes.append(np.linalg.norm(after - 2 * at + before, axis=-1) / AROUND)
        yield from (np.linalg.norm(at - before, axis=-1) / AROUND, sizes[-1])
    yield np.log(sizes[0]) - np.log(sizes[1])


def _read(position: np.ndarray, answers: dict[str, np.ndarray], twin: np.ndarray) -> dict[str, np.ndarray]:
    """Per confounder: (experiment, object or axis) bool, whether it is read rightly."""
    seen = np.stack([features(position, k) for k in range(position.shape[2])], axis=1)
    right: dict[str, np.ndarray] = {}
    for name, answer in tqdm(answers.items(), unit="confounder"):
        if name == "mass and friction":
            right[name] = right["mass"] & right["friction"]
        elif name.startswith("gravity"):
            right[name] = np.stack([_foretold(seen[:, :1], axis[:, None], twin)[:, 0] for axis in answer.T], axis=1)
        else:
            right[name] = _foretold(seen, answer, twin)
    return right


def _foretold(seen: np.ndarray, answer: np.ndarray, twin: np.ndarray) -> np.ndarray:
    """(experiment, object) bool; every object is judged by trees that were fitted without its experiment and the twin."""
    rows, values = seen.reshape(-1, seen.shape[-1]), answer.ravel()
    found = np.zeros(len(values), dtype=int)
    with threadpool_limits(1):  # on trees this small, several threads wait for each other
        for fitted, tested in GroupKFold(NUM_FOLDS).split(rows, groups=np.repeat(twin, answer.shape[1])):
            trees = HistGradientBoostingClassifier(early_stopping=False, random_state=0)
            found[tested] = trees.fit(rows[fitted], values[fitted]).predict(rows[tested])
    return np.asarray((found == values).reshape(answer.shape))


def _cells(arrays: Arrays, spec: DatasetSpec) -> Iterator[tuple[str, np.ndarray]]:
    """Names of all cells together, and of each if there are several, with (experiment,) bool."""
    names = spec.scenario.cells()
    yield "all", np.ones(len(arrays["cell"]), dtype=bool)
    if len(names) > 1:
        for number, name in enumerate(names):
            if (chosen := arrays["cell"] == number).any():
                yield name, chosen


def _share(right: np.ndarray, twin: np.ndarray) -> str:
    values = right.mean(axis=1)
    low, high = interval(values, twin)
    return f"{values.mean():.0%} [{low:.0%}, {high:.0%}]"


def _nearest(values: np.ndarray, grid: np.ndarray) -> np.ndarray:
    return np.asarray(np.abs(values[..., None] - grid).argmin(axis=-1))


def _most_frequent(answer: np.ndarray) -> float:
    return float(np.bincount(answer.ravel()).max() / answer.size)


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("overrides", nargs="*", help="as of src/generate.py: scenario=balls size=small")
    main(*parser.parse_args().overrides)
