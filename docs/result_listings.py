"""Tables that list what other files have: the published weights, measurements on a GPU, and the columns of results.csv."""

import csv
from pathlib import Path

from result_runs import ROOT, Results, markdown

GPU = ROOT / "docs" / "results" / "gpu.csv"
GPU_WAYS = {
    "CPU": "one CPU core",
    "float32, eager": "GPU",
    "bfloat16, eager": "bfloat16",
    "float32, graph": "CUDA graph",
    "bfloat16, graph": "both",
}


def read_csv(path: Path) -> list[dict[str, str]]:
    """Return the lines of a CSV."""
    with path.open(newline="") as lines:
        return list(csv.DictReader(lines))


def checkpoints(results: Results) -> str:
    """The published weights; those whose row of results.csv is another training are marked."""
    rows = []
    for line in read_csv(ROOT / "checkpoints" / "index.csv"):
        if line["method"] == "derenderer":
            continue
        runs = results.of(line["scenario"], line["split"], line["method"])
        same = [f"{run['mse']:.4f}" for run in runs if run["seed"] == 0] == [line["test_mse"]]
        rows.append(
            [f"`{line['file']}`", line["sha256"][:8], f"`{line['choice']}`", line["test_mse"] + ("" if same else " ᶜ")]
        )
    return markdown(["file", "SHA-256", "trained with", "test MSE, m²"], rows)


def derenderers() -> str:
    """The published weights of de-renderers."""
    rows = [
        [
            f"`{line['file']}`",
            line["sha256"][:8],
            f"`{line['choice']}`",
            f"{float(line['euclidean_error']):.2f}",
            f"{float(line['presence_accuracy']):.2%}",
        ]
        for line in read_csv(ROOT / "checkpoints" / "index.csv")
        if line["method"] == "derenderer"
    ]
    return markdown(["file", "SHA-256", "trained with", "test position error, m", "presence correct"], rows)


def column_meanings() -> str:
    """What the columns of results.csv mean."""
    meanings = read_csv(ROOT / "docs" / "results" / "columns.csv")
    has_interval = {line["column"].removesuffix("_low") for line in meanings if line["column"].endswith("_low")}
    rows = [
        [f"`{name}`{' *' if name in has_interval else ''}", line["meaning"], line["unit"] or "–"]
        for line in meanings
        if not (name := line["column"]).endswith(("_low", "_high"))
    ]
    return markdown(["column", "meaning", "unit"], rows)


def gpu_steps() -> str:
    """Experiments (of a de-renderer: frames) per second of training steps, by model, batch and way."""
    rows = [row for row in read_csv(GPU) if row["batch"] and row["unit"] in ("experiments/s", "frames/s")]
    rates = {(row["what"], row["batch"], row["how"]): f"{float(row['median']):,.0f}" for row in rows}
    busy = {
        (row["what"], row["batch"]): f"{100 * float(row['median']):.0f} %"
        for row in read_csv(GPU)
        if row["unit"] == "share of time in kernels" and row["how"] == "float32, eager"
    }
    trained = dict.fromkeys((model, batch) for model, batch, _ in rates)
    lines = [
        [f"`{model}`", batch, *(rates.get((model, batch, way), "–") for way in GPU_WAYS), busy.get((model, batch), "–")]
        for model, batch in trained
    ]
    return markdown(["model", "batch", *GPU_WAYS.values(), "kernels run"], lines)


def gpu_trainings() -> str:
    """Whole trainings: seconds of an epoch, and the validation MSE after some of them."""
    lines = [
        [*names, f"{float(seconds):.1f}", epochs, f"{float(error):.3f}"]
        for _, *names, seconds, epochs, error in map(dict.values, read_csv(GPU.with_name("gpu_trainings.csv")))
    ]
    return markdown(["training", "batch", "on", "s per epoch", "after epochs", "validation MSE, m²"], lines)


def gpu_renderers() -> str:
    """Frames per second of both renderers on the machine with the GPU."""
    rates = {(row["what"], row["how"]): row["median"] for row in read_csv(GPU) if row["unit"] == "frames/s"}
    sizes = [what for what, how in rates if how == "egl"]
    lines = [[size, *(f"{float(rates[size, how]):.0f}" for how in ("tiny", "egl"))] for size in sizes]
    return markdown(["frames/s", "CPU (`tiny`)", "GPU (`egl`)"], lines)
