"""An export as parquet has every value of the dataset, and pandas reads it."""

import io
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from cophy.dataset import parquet
from cophy.dataset.parquet import export
from cophy.dataset.states import States
from cophy.errors import CophyError
from tests.conftest import SCENARIOS, cached_settings, once_per_session, tiny_spec

arrow = pytest.importorskip("pyarrow.parquet")
SPLIT_NAMES = ("train", "validation", "test")


@pytest.fixture(scope="module")
def root(tiny_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with every scenario."""

    def write(folder: Path) -> None:
        for name in SCENARIOS:
            export(States(tiny_spec(name), tiny_data), None, folder)

    return once_per_session(tmp_path_factory, "parquet", write)


def folder_of(root: Path, name: str) -> Path:
    return root / f"{name}-{SCENARIOS[name]}"


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_value_is_in_its_split(name: str, root: Path, tiny_data: Path) -> None:
    stored, ids = States(tiny_spec(name), tiny_data).load(), []
    for number, split in enumerate(SPLIT_NAMES):
        table = arrow.read_table(folder_of(root, name) / f"{split}-00000-of-00001.parquet")
        rows = table["id"].to_numpy()
        ids += rows.tolist()
        assert (stored["split"][rows] == number).all()
        assert {*table.column_names} == {"id", *stored}
        for field, array in stored.items():
            values = table[field].to_pandas().to_numpy()
            values = np.stack(values).reshape(-1, *array.shape[1:]) if array.ndim > 1 else values
            np.testing.assert_array_equal(values, array[rows], err_msg=field)
    assert sorted(ids) == list(range(48))


def test_the_twins_of_the_test_split_are_in_a_file_of_their_own(root: Path, tiny_data: Path) -> None:
    folder = folder_of(root, "balls")
    assert set(arrow.read_table(folder / "test-00000-of-00001.parquet")["twin"].to_pylist()) == {-1}
    original = States(tiny_spec("balls"), tiny_data).directory / "test_twins.csv"
    assert (folder / "test_twins.csv").read_bytes() == original.read_bytes()
    head = yaml.safe_load((root / "README.md").read_text().split("---")[1])
    assert all("test_twins" not in str(config["data_files"]) for config in head["configs"])


def test_the_card_lists_every_dataset_and_array(root: Path) -> None:
    text = (root / "README.md").read_text()
    head = yaml.safe_load(text.split("---")[1])
    assert [config["config_name"] for config in head["configs"]] == ["balls-4", "blocktower-3", "collision-2"]
    for config in head["configs"]:
        for files in config["data_files"]:
            assert list(root.glob(files["path"]))
    assert head["size_categories"] == ["n<1K"]
    (line,) = re.findall(r"\| `states` .*", text)
    assert "[2, 120, 9, 13]" in line
    assert "[2, 60, 4, 13]" in line
    (line,) = re.findall(r"\| `do_operation` .*", text)
    assert "balls-4: what changes A into C: 0: displace, 1: remove" in line
    manifest = json.loads((root / "collision-2" / "manifest.json").read_bytes())
    assert manifest["configuration"]["scenario"]["camera"]["field_of_view_deg"] == 50


def test_the_code_of_the_card_runs(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """That of pandas; `datasets` is not installed here."""
    monkeypatch.chdir(root)
    _, code = re.findall(r"```python\n(.*?)```", (root / "README.md").read_text(), re.DOTALL)
    found: dict = {}
    exec(code, found)
    assert found["states"].shape == (34, 2, 120, 9, 13)


def test_images_are_png_files_in_small_row_groups(
    drawn: Callable[[str], tuple[States, "Drawn"]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    states, images = drawn("collision")
    monkeypatch.setitem(parquet.ROWS, True, (20, 8))
    folder = export(states, images, tmp_path)  # type: ignore[arg-type]
    files = sorted(folder.glob("train-*.parquet"))
    assert [arrow.ParquetFile(file).metadata.num_rows for file in files] == [20, 14]
    assert [arrow.ParquetFile(files[0]).metadata.row_group(number).num_rows for number in range(3)] == [8, 8, 4]
    row = arrow.read_table(files[1]).to_pylist()[-1]
    for name in ("rgb", "depth"):
        pixels = np.stack([np.asarray(Image.open(io.BytesIO(image["bytes"]))) for image in row[name]])
        expected = images.pictures({}, ("rgb", "depth"))(row["id"])[name]
        np.testing.assert_array_equal(pixels.reshape(expected.shape), expected)


class Drawn:
    """Images that cost nothing: colours and depths depend on experiment and frame."""

    name = "images-4"
    render = cached_settings("generate", "render=all", "render.resolution=16", "render.modalities=[rgb,depth]").render

    def pictures(self, arrays: object, modalities: object) -> Callable[[int], dict[str, np.ndarray]]:
        def read(row: int) -> dict[str, np.ndarray]:
            rng = np.random.default_rng(row)
            rgb = rng.integers(0, 256, (2, 15, 4, 4, 3), dtype=np.uint8)
            return {"rgb": rgb, "depth": rng.integers(0, 65536, (2, 15, 4, 4), dtype=np.uint16)}

        return read


@pytest.fixture
def drawn(tiny_data: Path) -> Callable[[str], tuple[States, Drawn]]:
    return lambda name: (States(tiny_spec(name), tiny_data), Drawn())


def test_an_interrupted_export_continues_and_other_data_are_refused(tiny_data: Path, tmp_path: Path) -> None:
    states = States(tiny_spec("collision"), tiny_data)
    folder = export(states, None, tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    (folder / "validation-00000-of-00001.parquet").unlink()
    manifest = json.loads((folder / "manifest.json").read_bytes())
    kept = {key: value for key, value in manifest.items() if key not in ("arrays", "splits", "files")}
    (folder / "manifest.json").write_text(json.dumps(kept))
    time = (folder / "train-00000-of-00001.parquet").stat().st_mtime_ns
    export(states, None, tmp_path)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
    assert (folder / "train-00000-of-00001.parquet").stat().st_mtime_ns == time
    with pytest.raises(CophyError, match="holds other data than 2-tiny-"):
        export(states, Drawn(), tmp_path)  # type: ignore[arg-type]
    (folder / "manifest.json").unlink()
    with pytest.raises(CophyError, match="choose another root="):
        export(states, None, tmp_path)


def test_without_pyarrow_the_extra_is_named(tiny_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parquet, "find_spec", lambda name: None)
    with pytest.raises(CophyError, match=r"pip install 'cophy\[parquet\]'"):
        export(States(tiny_spec("collision"), tiny_data), None, tmp_path)


def test_the_metadata_describe_every_array_and_file(root: Path) -> None:
    metadata = json.loads((root / "croissant.json").read_bytes())
    files = {file["contentUrl"] for file in metadata["distribution"] if "sha256" in file}
    assert files == {path.relative_to(root).as_posix() for path in root.rglob("*.parquet")}
    for records in metadata["recordSet"]:
        manifest = json.loads((root / records["name"] / "manifest.json").read_bytes())
        described = {field["name"]: field["description"] for field in records["field"]}
        assert described.keys() == manifest["arrays"].keys()
        assert all(manifest["arrays"][name]["meaning"] in text for name, text in described.items())
