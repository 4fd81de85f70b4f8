"""Predictions from outside: files of both kinds give the numbers of the arrays in them, and faults get one line."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cophy
from cophy.errors import CophyError
from cophy.scoring import Predictions, Truth
from cophy.submission import load_truth, read_predictions_file
from tests.commands import python, run, train
from tests.conftest import ROOT, refused
from tests.test_scoring import truth as small_truth

NEEDS_ARROW = pytest.mark.skipif(
    subprocess.run([sys.executable, "-c", "import pyarrow"], capture_output=True, check=False).returncode != 0,
    reason="pyarrow is not installed",
)


@pytest.fixture(scope="module")
def truth(tiny_data: Path) -> Truth:
    """The truth of the tiny test split; tests only read it."""
    return load_truth("collision", size="tiny", data_dir=tiny_data)


def score(*arguments: object, data: Path, **ending: int) -> str:
    return run("score", "scenario=collision", "size=tiny", f"data_dir={data}", *arguments, **ending)


def test_the_scores_of_a_run_are_those_of_its_file_to_the_last_digit(tiny_data: Path, tmp_path: Path) -> None:
    for scenario, model in (("collision", "copy_b"), ("blocktower", "cophynet")):
        train(f"scenario={scenario}", f"model={model}", f"source.outputs={tmp_path}", data=tiny_data)
        (path,) = tmp_path.glob(f"{scenario}/*/{model}/*/*/*/predictions.npz")
        trained = json.loads(path.with_name("metrics.json").read_text())
        keys = ("name=elsewhere", f"predictions={path}", f"outputs={tmp_path}", f"data_dir={tiny_data}")
        run("score", f"scenario={scenario}", "size=tiny", *keys)
        (scored_path,) = tmp_path.glob(f"{scenario}/*/elsewhere/*/*/*/metrics.json")
        scored = json.loads(scored_path.read_text())
        probed = {name for name in trained["metrics"] if name.startswith("probe")}
        for key in ("metrics", "intervals"):
            assert scored[key] == {name: value for name, value in trained[key].items() if name not in probed}
        for key in ("copies", "num_train", "num_test", "dataset_ids", "metric_dims"):
            assert scored[key] == trained[key]
        arrays, others = (np.load(each.with_name("predictions.npz")) for each in (path, scored_path))
        for name in others:
            np.testing.assert_array_equal(arrays[name], others[name])


def test_scores_of_cells_and_do_operations_are_those_of_their_experiments(tiny_data: Path, tmp_path: Path) -> None:
    score(f"template={tmp_path}/still.npz", data=tiny_data)
    score(f"predictions={tmp_path}/still.npz", f"outputs={tmp_path}", data=tiny_data)
    (path,) = tmp_path.glob("collision/all/still/*/*/*/metrics.json")
    content = json.loads(path.read_text())
    for of_kind in content["groups"].values():
        total = sum(group["num_test"] * group["metrics"]["mse"] for group in of_kind.values())
        assert sum(group["num_test"] for group in of_kind.values()) == content["num_test"]
        assert total / content["num_test"] == pytest.approx(content["metrics"]["mse"], rel=1e-9)
    assert content["metrics"]["mse"] == content["copies"]["copy_c"]
    assert content["metrics"]["twin_difference_explained"] == 0.0


@pytest.mark.parametrize("order", ["as in the dataset", "shuffled"])
def test_the_order_of_a_file_does_not_matter(order: str, truth: Truth, tmp_path: Path) -> None:
    rows = np.random.default_rng(0).permutation(len(truth.experiment)) if order == "shuffled" else slice(None)
    position = truth.position + np.random.default_rng(1).normal(size=truth.position.shape)
    expected = cophy.score(Predictions(truth.experiment, position), truth)
    np.savez(tmp_path / "mine.npz", experiment=truth.experiment[rows], position=position[rows])
    found = cophy.score(read_predictions_file(tmp_path / "mine.npz", truth), truth)
    assert found.means() == expected.means()


def test_samples_are_scored_by_hand() -> None:
    """D is 0. Samples of the first experiment's objects are all at x = 1 and all at x = 3: RMSE 1/√3 and 3/√3, apart 2/√3."""
    truth = small_truth()
    samples = np.zeros((2, 2, 2, 2, 3))
    samples[0, 0, ..., 0], samples[0, 1, ..., 0] = 1.0, 3.0
    predictions = Predictions(truth.experiment, samples.mean(axis=1), samples=samples)
    values = cophy.score(predictions, truth).values
    np.testing.assert_allclose(values["energy_score"], [(2 - 1) / np.sqrt(3), 0.0])
    np.testing.assert_allclose(values["best_sample_mse"], [1 / 3, 0.0])
    np.testing.assert_allclose(values["mse"], [4 / 3, 0.0])


def test_samples_are_scored_in_the_coordinates_that_count() -> None:
    """As above, with z anywhere: RMSE 1/√2 and 3/√2, apart 2/√2."""
    samples = np.zeros((2, 2, 2, 2, 3))
    samples[..., 2] = np.random.default_rng(0).normal(size=(2, 2, 2, 2))
    samples[0, 0, ..., 0], samples[0, 1, ..., 0] = 1.0, 3.0
    flat = small_truth(metric_dims=2)
    values = cophy.score(Predictions(flat.experiment, samples.mean(axis=1), samples=samples), flat).values
    np.testing.assert_allclose(values["energy_score"], [(2 - 1) / np.sqrt(2), 0.0])
    np.testing.assert_allclose(values["best_sample_mse"], [1 / 2, 0.0])


def test_one_sample_is_scored_as_a_prediction() -> None:
    position = np.random.default_rng(0).normal(size=(2, 2, 2, 3))
    truth = small_truth()
    values = cophy.score(Predictions(truth.experiment, position, samples=position[:, None]), truth).values
    np.testing.assert_allclose(values["best_sample_mse"], values["mse"])
    np.testing.assert_allclose(values["energy_score"], np.sqrt(values["mse"]))


def test_the_true_distribution_has_the_best_energy_score(truth: Truth) -> None:
    rng, shape = np.random.default_rng(0), (len(truth.experiment), 16, *truth.position.shape[1:])

    def expected_score(scale: float) -> float:
        drawn = rng.normal(size=truth.position.shape)
        samples = scale * rng.normal(size=shape)
        outcome = Truth(**{**vars(truth), "position": drawn})
        return cophy.score(Predictions(truth.experiment, samples.mean(axis=1), samples=samples), outcome).means()[
            "energy_score"
        ]

    right, narrow, wide = expected_score(1.0), expected_score(0.3), expected_score(3.0)
    assert right < min(narrow, wide)


def filled(truth: Truth, **changes: Any) -> dict[str, np.ndarray]:
    return {"experiment": truth.experiment, "position": truth.position.copy(), **changes}


# those of the reader, and one of `cophy.score`, of which test_scoring.py has all
ARRAYS: dict[str, tuple[Callable[[Truth], dict[str, np.ndarray]], str]] = {
    "no ids": (lambda truth: {"position": truth.position}, "experiment"),
    "no positions": (lambda truth: {"experiment": truth.experiment}, "neither position nor samples"),
    "samples without an axis": (lambda truth: filled(truth, samples=truth.position), "not floats of (n, S, T-1, K, 3)"),
    "objects": (lambda truth: filled(truth, position=np.array([{}], dtype=object)), "allow_pickle=False"),
    "logits of another shape": (
        lambda truth: filled(truth, stable_logit=np.zeros((3, 3))),
        "stable_logit is float64 of shape (3, 3)",
    ),
}


@pytest.mark.parametrize("fault", ARRAYS)
def test_faults_of_arrays_get_one_line(fault: str, truth: Truth, tmp_path: Path) -> None:
    make, message = ARRAYS[fault]
    np.savez(tmp_path / "mine.npz", **make(truth))
    with refused(message):
        cophy.score(read_predictions_file(tmp_path / "mine.npz", truth), truth)


FILES: dict[str, tuple[Callable[[Path], None], str]] = {
    "text": (lambda path: path.write_text("id,x\n"), "is not a zip file"),
    "nothing": (lambda path: None, "No such file"),
    "a folder": (lambda path: path.mkdir(), "not a regular file"),
    "half a file": (lambda path: path.write_bytes(half()), "is not a zip file"),
}


def half() -> bytes:
    import io

    file = io.BytesIO()
    np.savez(file, experiment=np.arange(100), position=np.zeros((100, 2)))
    return file.getvalue()[: len(file.getvalue()) // 2]


@pytest.mark.parametrize("fault", FILES)
def test_faults_of_files_get_one_line(fault: str, truth: Truth, tmp_path: Path) -> None:
    make, message = FILES[fault]
    make(tmp_path / "mine.npz")
    with refused(message) as error:
        read_predictions_file(tmp_path / "mine.npz", truth)
    assert str(error.value).startswith(f"{tmp_path}/mine.npz: ")


def test_a_zip_bomb_is_refused(truth: Truth, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cophy.atomic_files.MAX_ARRAY_BYTES", 1 << 20)
    np.savez_compressed(tmp_path / "mine.npz", position=np.zeros(1 << 20))
    assert (tmp_path / "mine.npz").stat().st_size < 1 << 20
    with refused("mine.npz: more than 1048576 bytes of arrays"):
        read_predictions_file(tmp_path / "mine.npz", truth)


def test_a_file_has_one_of_two_endings(truth: Truth, tmp_path: Path) -> None:
    with pytest.raises(CophyError, match=r"has to end in \.npz or \.parquet"):
        read_predictions_file(tmp_path / "mine.json", truth)


def table(truth: Truth) -> dict[str, np.ndarray]:
    row, step, slot = np.nonzero(np.broadcast_to(truth.presence[:, None], truth.position.shape[:3]))
    x, y, z = truth.position[row, step, slot].T
    return {"id": truth.experiment[row], "slot": slot, "frame": step + 1, "x": x, "y": y, "z": z}


def write(path: Path, columns: dict[str, Any]) -> None:
    from pyarrow import parquet
    from pyarrow import table as to_table

    parquet.write_table(to_table(columns), path)


@NEEDS_ARROW
def test_a_table_gives_the_numbers_of_its_arrays(truth: Truth, tmp_path: Path) -> None:
    position = truth.position + np.random.default_rng(0).normal(size=truth.position.shape)
    logit = np.random.default_rng(1).normal(size=truth.stable.shape)
    moved = Truth(**{**vars(truth), "position": position, "stable": logit > 0})
    order = np.random.default_rng(2).permutation(truth.presence.sum() * position.shape[1])
    row, step, slot = np.nonzero(np.broadcast_to(truth.presence[:, None], position.shape[:3]))
    columns = table(moved) | {"stable_logit": logit[row, step, slot]}
    write(tmp_path / "mine.parquet", {name: column[order] for name, column in columns.items()})
    found = cophy.score(read_predictions_file(tmp_path / "mine.parquet", truth), truth)
    assert found.means() == cophy.score(Predictions(truth.experiment, position, logit), truth).means()


def test_a_variance_in_a_file_lowers_no_error(truth: Truth, tmp_path: Path) -> None:
    position = truth.position + 1
    np.savez(
        tmp_path / "mine.npz", experiment=truth.experiment, position=position, draw_variance=np.ones_like(position)
    )
    found = cophy.score(read_predictions_file(tmp_path / "mine.npz", truth), truth)
    assert found.means()["mse"] == pytest.approx(1.0)


@NEEDS_ARROW
def test_a_table_may_hold_samples(truth: Truth, tmp_path: Path) -> None:
    samples = np.random.default_rng(0).normal(size=(len(truth.experiment), 3, *truth.position.shape[1:]))
    tables = [
        table(Truth(**{**vars(truth), "position": samples[:, index]}))
        | {"sample": np.full(truth.presence.sum() * samples.shape[2], index)}
        for index in range(3)
    ]
    write(tmp_path / "mine.parquet", {name: np.concatenate([each[name] for each in tables]) for name in tables[0]})
    found = cophy.score(read_predictions_file(tmp_path / "mine.parquet", truth), truth).means()
    expected = cophy.score(Predictions(truth.experiment, samples.mean(axis=1), samples=samples), truth).means()
    assert found == pytest.approx(expected, rel=1e-12)


def without(columns: dict[str, np.ndarray], rows: slice) -> dict[str, np.ndarray]:
    return {name: column[rows] for name, column in columns.items()}


def with_first(columns: dict[str, np.ndarray], name: str, value: int) -> dict[str, np.ndarray]:
    changed = columns[name].copy()
    changed[0] = value
    return columns | {name: changed}


def empty_slot(columns: dict[str, np.ndarray]) -> int:
    """Return a slot of the first line's experiment that holds no object."""
    return min({*range(4)} - {*columns["slot"][columns["id"] == columns["id"][0]].tolist()})


TABLES: dict[str, tuple[Callable[[dict[str, np.ndarray]], dict[str, Any]], str]] = {
    "a column is missing": (lambda t: {name: t[name] for name in t if name != "frame"}, "columns frame are missing"),
    "a line is missing": (lambda t: without(t, slice(1, None)), "1 lines are missing, the first is id"),
    "a line is there twice": (lambda t: {n: np.append(c, c[:1]) for n, c in t.items()}, "1 lines are there twice"),
    "an unknown id": (lambda t: with_first(t, "id", 10**9), "1 lines name an experiment that is not in this"),
    "frame 0": (lambda t: with_first(t, "frame", 0), "1 lines have a frame that is not from 1 to 14"),
    "slot 9": (lambda t: with_first(t, "slot", 9), "1 lines have a slot that is not from 0 to 3"),
    "an empty slot": (
        lambda t: with_first(t, "slot", empty_slot(t)),
        "1 lines name a slot that is empty in C, the first",
    ),
    "a huge sample": (lambda t: t | {"sample": np.arange(len(t["id"])) + 10**12}, "sample number that is too large"),
    "texts": (lambda t: t | {"x": ["a"] * len(t["x"])}, "x: these columns hold no numbers"),
    "ids are floats": (lambda t: t | {"id": t["id"] * 1.0}, "id: these columns hold no integers"),
    "nulls": (lambda t: t | {"y": [None, *t["y"][1:].tolist()]}, "y: values are missing"),
    "a NaN": (lambda t: t | {"z": t["z"] * np.nan}, "has non-finite values"),
}


@NEEDS_ARROW
def test_a_column_that_is_there_twice_is_named(truth: Truth, tmp_path: Path) -> None:
    from pyarrow import Table, parquet

    columns = table(truth)
    repeated = Table.from_arrays([*columns.values(), columns["id"]], names=[*columns, "id"])
    parquet.write_table(repeated, tmp_path / "mine.parquet")
    with refused("columns id are there twice"):
        read_predictions_file(tmp_path / "mine.parquet", truth)


@NEEDS_ARROW
@pytest.mark.parametrize("fault", TABLES)
def test_faults_of_tables_get_one_line(fault: str, truth: Truth, tmp_path: Path) -> None:
    make, message = TABLES[fault]
    write(tmp_path / "mine.parquet", make(table(truth)))
    with refused(message):
        cophy.score(read_predictions_file(tmp_path / "mine.parquet", truth), truth)


@pytest.mark.parametrize("ending", ["npz", pytest.param("parquet", marks=NEEDS_ARROW)])
def test_a_template_can_be_scored_and_is_not_replaced(
    ending: str, truth: Truth, tiny_data: Path, tmp_path: Path
) -> None:
    path = tmp_path / f"mine.{ending}"
    score(f"template={path}", data=tiny_data)
    still = np.repeat(truth.initial[:, None], truth.position.shape[1], axis=1)
    expected = cophy.score(Predictions(truth.experiment, still), truth).means()
    assert cophy.score(read_predictions_file(path, truth), truth).means() == expected
    if ending == "npz":
        ids = np.load(path)["experiment"]
    else:
        from pyarrow import parquet

        ids = parquet.read_table(path)["id"].to_numpy()
    assert (np.diff(ids) >= 0).all()  # the order does not tell which are twins
    assert "exists: choose another name" in score(f"template={path}", data=tiny_data, code=1)


def test_results_of_a_training_are_not_replaced(tiny_data: Path, tmp_path: Path) -> None:
    train("scenario=collision", "model=copy_c", "trainer.max_epochs=40", f"source.outputs={tmp_path}", data=tiny_data)
    (path,) = tmp_path.glob("collision/all/copy_c/*/*/*/predictions.npz")
    before = path.with_name("metrics.json").read_bytes()
    text = score("name=copy_c", f"predictions={path}", f"outputs={tmp_path}", data=tiny_data, code=1)
    assert "belongs to a training" in text
    assert path.with_name("metrics.json").read_bytes() == before


def test_data_are_never_generated(tmp_path: Path) -> None:
    text = score(f"template={tmp_path}/mine.npz", data=tmp_path / "data", code=1)
    assert "is not finished: run `python src/generate.py scenario=collision" in text
    assert not (tmp_path / "data").exists()


def test_scoring_imports_no_torch(tiny_data: Path, tmp_path: Path) -> None:
    program = f"""
import sys
sys.argv = ["score.py", "scenario=collision", "size=tiny", "data_dir={tiny_data}", "template={tmp_path}/mine.npz"]
from cophy.commands.score import main
main()
sys.argv[-1] = "predictions={tmp_path}/mine.npz"
sys.argv.append("outputs={tmp_path}/outputs")
main()
import cophy
cophy.load_truth("collision", size="tiny", data_dir="{tiny_data}")
assert not {{"torch", "lightning", "pybullet"}} & set(sys.modules), sorted(sys.modules)
"""
    python("-c", program, cwd=ROOT)
