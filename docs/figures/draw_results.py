"""Draw experiments and predictions: python docs/figures/draw_results.py [--size small] [--data-dir data]

Missing data are generated first. The predictors in checkpoints/ predict the test split.
"""

import io
from argparse import ArgumentParser
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

import cophy
from cophy.config import folder, generated_by, settings
from cophy.dataset.datamodules import ExperimentDataset
from cophy.dataset.difficulty import twin_differences
from cophy.dataset.splits import SPLITS
from cophy.dataset.states import clusters_of, sort_by_twins
from cophy.drawing.overview import NO_BREAK, Descriptions
from cophy.drawing.plots import error_over_time
from cophy.drawing.sheets import REACH, CloseUp, resize, side_by_side, window_of_motion
from cophy.report.predictions import interval_half_width
from cophy.scenario import Camera
from cophy.scenario.camera import Window
from cophy.scenario.rendering import Backend, Renderer, RenderSettings
from cophy.schemas import register
from cophy.scoring import mean_squared_error

HERE = Path(__file__).parent
CHECKPOINTS = HERE.parents[1] / "checkpoints"
RUNS = {"blocktower": "blocktower_3to3", "balls": "balls_4to4", "collision": "collision_all"}
LABELS = {"blocktower": "towers", "balls": "balls", "collision": "collisions"}
TITLES = {"blocktower": "towers of three", "balls": "four balls", "collision": "collisions"}
METHODS = {"copy C": "#8a8f98", "IN": "#d08a1d", "CoPhyNet": "#1f5fa8", "alongside": "#1d7a3d"}
LEARNED = {"IN": "in", "CoPhyNet": "cophynet", "alongside": "alongside"}  # method -> end of the checkpoint's name
SHOWN_QUANTILE = 0.9  # of the differences between the D of twins: the pair of the gallery and the clips
PERCENTILES = {"good": 10, "median": 50, "bad": 90}
OBSERVED, COUNTERFACTUAL, INK = "#1f5fa8", "#a8561f", "#1c1f24"
WIDTH_IN, DPI = 7, 200  # 100 pixels of the page per inch
PIXELS = 640  # of a rendered image before matplotlib reduces it, which smooths edges
CLIP_PX = 280
CLIP = RenderSettings([], resolution=420, backend=Backend.tiny)
CELL = RenderSettings([], resolution=PIXELS, backend=Backend.tiny)
WIDER = 1.4  # field of view of predictions, times that of the dataset
COLORS = 256  # of a palette
PALETTE = Image.Quantize.MAXCOVERAGE  # keeps the colours of small objects


@dataclass(frozen=True)
class Held:
    """Experiments that no checkpoint was trained on, twins next to each other."""

    arrays: dict[str, np.ndarray]
    true: np.ndarray  # (N, T-1, K, 3) positions in D, metres
    dims: int  # coordinates that count

    @property
    def presence(self) -> np.ndarray:
        """Return which slots hold an object in C and D, (N, K)."""
        return self.arrays["presence"][:, 1]

    def mse(self, predicted: np.ndarray) -> np.ndarray:
        """Return the MSE of each experiment, m²."""
        return mean_squared_error(predicted, self.true, self.presence, self.dims)


def shown(arrays: dict[str, np.ndarray]) -> int:
    """Return the experiment of the gallery and the clips, whose twin is the next one."""
    difference = twin_differences(arrays)[:, 1]
    return 2 * int(np.abs(difference - np.quantile(difference, SHOWN_QUANTILE)).argmin())


def held_out(data: ExperimentDataset) -> Held:
    """Select the experiments of the test split."""
    arrays = {name: array[data.arrays["split"] == SPLITS.index("test")] for name, array in data.arrays.items()}
    positions = arrays["states"][:, 1, :: data.scenario.clock.states_per_frame, :, :3]
    return Held(arrays, positions[:, 1:], data.scenario.task.metric_dims)


def predict(name: str, held: Held) -> dict[str, np.ndarray]:
    """Return the predictions of D of every method, (N, T-1, K, 3) metres."""
    experiments = {key: torch.from_numpy(held.arrays[key]) for key in ("states", "presence")}
    predictions = {"copy C": np.broadcast_to(held.arrays["states"][:, 1, :1, :, :3], held.true.shape)}
    for method, end in LEARNED.items():
        predictor = cophy.load_predictor(CHECKPOINTS / f"{RUNS[name]}_{end}.ckpt")
        predictions[method] = predictor(experiments).numpy()
    return predictions


def frame(axis: Axes, image: np.ndarray, color: str, title: str = "") -> None:
    """Show an image in a coloured frame."""
    axis.imshow(image)
    axis.set_xticks([])
    axis.set_yticks([])
    if title:
        axis.set_title(title, fontsize=9, pad=4, color=color)
    for spine in axis.spines.values():
        spine.set(color=color, linewidth=1.2)


def gallery(data: dict[str, ExperimentDataset]) -> Figure:
    """Draw A, B, C, D and the twin's D of one experiment per scenario; a ring marks the object that is moved."""
    figure = Figure(figsize=(WIDTH_IN, 4.75), dpi=DPI)
    axes = figure.subplots(3, 5)
    figure.subplots_adjust(left=0.04, right=0.995, top=0.945, bottom=0.035, wspace=0.04, hspace=0.17)
    for axis, title in zip(axes[0], ("A", "B", "C", "D", "D of the twin"), strict=True):
        axis.set_title(title, fontsize=10, pad=4, color=OBSERVED if title in "AB" else COUNTERFACTUAL)
    for row, (name, dataset) in zip(axes, data.items(), strict=True):
        scenario, arrays, experiment = dataset.scenario, dataset.arrays, shown(dataset.arrays)
        pair = [experiment, experiment + 1]
        close_up = CloseUp(scenario, arrays, pair, CELL)
        ab, cd = (frames.rgb for frames in close_up.frames(experiment, [0, -1]))
        _, twin = (frames.rgb for frames in close_up.frames(experiment + 1, [0, -1]))
        for column, image in enumerate((*ab, *cd, twin[1])):
            frame(row[column], image, OBSERVED if column < 2 else COUNTERFACTUAL)
        row[0].set_ylabel(LABELS[name], fontsize=10, labelpad=5)
        changed = Descriptions(scenario, arrays).do_operation(experiment).replace(NO_BREAK, " ")
        row[2].set_xlabel(f"do-operation: {changed}", fontsize=8.5, color=COUNTERFACTUAL, labelpad=3)
        moved = arrays["states"][experiment, 1, 0, arrays["do_slot"][experiment], :3]
        ring(row[2], scenario.camera, moved[None], window_of_motion(scenario, arrays, pair), [INK], size=21)
    return figure


def predictions(name: str, dataset: ExperimentDataset, held: Held, predicted: dict[str, np.ndarray]) -> Figure:
    """Draw a good, a median and a bad prediction of CoPhyNet, and those of alongside for the same experiments."""
    errors = {method: held.mse(predicted[method]) for method in ("CoPhyNet", "alongside")}
    order = errors["CoPhyNet"].argsort(kind="stable")
    figure = Figure(figsize=(WIDTH_IN, 5.75), dpi=DPI)
    axes = figure.subplots(3, 4)
    figure.subplots_adjust(left=0.045, right=0.995, top=0.89, bottom=0.01, wspace=0.04, hspace=0.13)
    for row, (case, percentile) in zip(axes, PERCENTILES.items(), strict=True):
        experiment = int(order[round(percentile / 100 * (len(order) - 1))])
        shown = {"C": held.arrays["states"][experiment, 1, 0, :, :3], "true D": held.true[experiment, -1]}
        shown |= {method: predicted[method][experiment, -1] for method in errors}
        present = held.presence[experiment]
        colors = list(compress(dataset.scenario.colors.values(), present))
        images, camera, window = render(dataset, held.arrays, experiment, shown)
        for axis, (what, image) in zip(row, images.items(), strict=True):
            title = f"MSE {in_words(errors[what][experiment])}" if what in errors else ""
            frame(axis, image, METHODS.get(what, COUNTERFACTUAL), title)
            if what != "C":
                ring(axis, camera, shown["true D"][present], window, colors, size=10)
        row[0].set_ylabel(f"{case} ({percentile}th percentile)", fontsize=9, labelpad=5)
    for axis, what in zip(axes[0], shown, strict=True):
        place = axis.get_position()
        style = {"ha": "center", "va": "bottom", "fontsize": 10, "color": METHODS.get(what, COUNTERFACTUAL)}
        figure.text((place.x0 + place.x1) / 2, place.y1 + 0.035, what, **style)
    end = f"{held.true.shape[1] / dataset.scenario.clock.frame_rate_hz:g} s"
    title = f"{TITLES[name].capitalize()}, D after {end}. Rings: true positions, in the objects' colours."
    figure.text(0.52, 0.98, title, ha="center", va="center", fontsize=10)
    return figure


def in_words(mse: float) -> str:
    """Format an MSE."""
    return f"{mse:.3f} m²" if mse >= 0.001 else "< 0.001 m²"


def render(
    dataset: ExperimentDataset, arrays: dict[str, np.ndarray], experiment: int, positions: dict[str, np.ndarray]
) -> tuple[dict[str, np.ndarray], Camera, Window]:
    """Render positions (K, 3) of several frames, cropped to one window.

    The field of view is wider than the dataset's, so that no object leaves the image. Objects are turned as in C, or in true D,
    because no model predicts rotations.

    Returns:
        Images, the camera and the window.
    """
    camera = dataset.scenario.camera
    camera = replace(camera, field_of_view_deg=WIDER * camera.field_of_view_deg)
    scenario = replace(dataset.scenario, camera=camera)
    presence, quaternions = arrays["presence"][experiment, 1], arrays["states"][experiment, 1, :, :, 3:7]
    points = np.concatenate([place[presence] for place in positions.values()])
    window = camera.window_around(points, REACH * scenario.object_size_m)
    with Renderer(scenario, round(PIXELS / window.edge)) as renderer:
        images = {
            what: renderer.render(
                place[None],
                quaternions[-1 if what == "true D" else 0][None],
                presence=presence,
                shapes=arrays["shape"][experiment].tolist(),
                background_seed=int(arrays["background_seed"][experiment]),
            ).rgb
            for what, place in positions.items()
        }
    return {what: window.cut(image)[0] for what, image in images.items()}, camera, window


def ring(axis: Axes, camera: Camera, places: np.ndarray, window: Window, colors: Sequence[str], size: float) -> None:
    """Draw rings around the projections of places (N, 3) on an image that is cropped to a window."""
    width = axis.images[0].get_array().shape[0]  # type: ignore[union-attr]
    centres = (camera.project(places, 1) - (window.left, window.top)) / window.edge * width - 0.5
    for (x, y), color in zip(centres.tolist(), colors, strict=True):
        for edge, line in (("white", 4.0), (color, 1.8)):
            axis.plot(x, y, "o", ms=size, mfc="none", mec=edge, mew=line)
    axis.set(xlim=(-0.5, width - 0.5), ylim=(width - 0.5, -0.5))


def errors_over_time(data: dict[str, ExperimentDataset], held: dict[str, Held], predicted: dict) -> Figure:
    """Draw the mean position error of each method over time, with 95 % bands over clusters of test experiments."""
    figure = Figure(figsize=(WIDTH_IN, 3.1), dpi=DPI)
    axes = figure.subplots(1, 3)
    figure.subplots_adjust(left=0.075, right=0.99, top=0.8, bottom=0.15, wspace=0.2)
    for axis, (name, experiments) in zip(axes, held.items(), strict=True):
        time = np.arange(experiments.true.shape[1] + 1) / data[name].scenario.clock.frame_rate_hz
        for method, color in METHODS.items():
            true, presence, dims = experiments.true, experiments.presence, experiments.dims
            errors = error_over_time(predicted[name][method], true, presence, dims=dims)
            # at t = 0, D is C
            mean, half = (
                np.pad(each, (1, 0))
                for each in (errors.mean(axis=0), interval_half_width(errors, experiments.arrays["cluster"]))
            )
            axis.plot(time, mean, color=color, lw=1.6, label=method)
            axis.fill_between(time, mean - half, mean + half, color=color, alpha=0.2, lw=0)
        axis.set_title(f"{TITLES[name]} (n = {len(experiments.true)})", fontsize=9)
        axis.set(xlim=(0, time[-1]), ylim=(0, None))
        axis.set_xlabel("time (s)", fontsize=9)
        axis.tick_params(labelsize=8)
        axis.grid(alpha=0.25)
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("mean position error (m)", fontsize=9)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="upper center", ncols=4, frameon=False, fontsize=10)
    return figure


def clip(dataset: ExperimentDataset, experiment: int) -> bytes:
    """Return AB and CD of an experiment, next to each other, as a GIF with one palette; titles take one line each."""
    scenario, arrays = dataset.scenario, dataset.arrays
    close_up = CloseUp(scenario, arrays, [experiment], CLIP)
    ab, cd = ([resize(image, CLIP_PX) for image in frames.rgb] for frames in close_up.frames(experiment, slice(None)))
    slot = int(arrays["do_slot"][experiment])
    name = Descriptions(scenario, arrays).object_name(experiment, slot)
    change = "moved" if arrays["presence"][experiment, 1, slot] else "removed"
    rate = scenario.clock.frame_rate_hz
    sequences = {"AB: observed": np.stack(ab), f"CD: {name} {change}": np.stack(cd)}
    frames = side_by_side(sequences, frame_rate_hz=rate)
    count, height, width, _ = frames.shape
    strip = Image.fromarray(frames.reshape(count * height, width, 3)).quantize(
        COLORS, PALETTE, dither=Image.Dither.NONE
    )
    first, *others = (strip.crop((0, n * height, width, (n + 1) * height)) for n in range(count))
    file = io.BytesIO()
    first.save(file, "GIF", save_all=True, append_images=others, duration=round(1000 / rate), loop=0)
    return file.getvalue()


def load(size: str, data_dir: Path) -> dict[str, ExperimentDataset]:
    """Return the dataset of each scenario."""
    register()
    datasets = {name: cophy.load(name, split=None, size=size, data_dir=data_dir) for name in RUNS}
    for name, dataset in datasets.items():
        spec = generated_by(settings("generate", f"scenario={name}", f"size={size}"))[0].spec
        dataset.arrays = sort_by_twins(dataset.arrays, spec)  # they share A and C
        dataset.arrays["cluster"] = clusters_of(spec, dataset.arrays["experiment"])
    return datasets


def figures(data: dict[str, ExperimentDataset]) -> dict[str, Figure]:
    """Return all figures by the names of their files."""
    torch.set_num_threads(1)
    held = {name: held_out(dataset) for name, dataset in data.items()}
    predicted = {name: predict(name, experiments) for name, experiments in held.items()}
    drawn = {f"predictions-{name}": predictions(name, data[name], held[name], predicted[name]) for name in RUNS}
    return {"gallery": gallery(data), "error_over_time": errors_over_time(data, held, predicted), **drawn}


def save(path: Path, figure: Figure) -> None:
    """Write a figure as PNG with a palette, a third as large as one without."""
    file = io.BytesIO()
    figure.savefig(file)
    palette = Image.open(file).convert("RGB").quantize(COLORS, PALETTE, dither=Image.Dither.NONE)
    palette.save(path, optimize=True)


if __name__ == "__main__":
    parser = ArgumentParser(description="Draw experiments and predictions.")
    parser.add_argument("--size", default="small", help="size of the datasets (default: small)")
    parser.add_argument("--data-dir", default=Path(folder("COPHY_DATA")), type=Path, help="where datasets are kept")
    options = parser.parse_args()
    datasets = load(options.size, options.data_dir)
    for name, dataset in datasets.items():
        (HERE / f"{name}.gif").write_bytes(clip(dataset, shown(dataset.arrays)))
    for name, figure in figures(datasets).items():
        save(HERE / f"{name}.png", figure)
