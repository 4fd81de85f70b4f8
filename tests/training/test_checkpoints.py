"""Checkpoints: whole or not at all, checked before anything is built from them, and compared with a configuration."""

import errno
import os
import re
import zipfile
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lightning
import numpy as np
import pytest
import torch
from torch import Tensor, nn

from cophy.config import composed, to_plain
from cophy.dataset.spec import FORMAT_VERSION
from cophy.errors import CophyError
from cophy.training.checkpoints import (
    MAX_VALUES,
    RESTORED,
    Checkpoint,
    WholeCheckpoints,
    build_network,
    check_plain_values,
    check_resumable,
    check_trained,
    read_checkpoint,
    read_file,
    restore_network,
)
from tests.conftest import RunsCode
from tests.training.saved import model_of, saved, weights_of

SOURCE = Path("a.ckpt")


def test_a_checkpoint_that_cannot_be_written_leaves_the_older_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "checkpoints" / "best.ckpt"
    WholeCheckpoints({}, tmp_path).save_checkpoint({"weights": torch.ones(3)}, path)
    before, write = path.read_bytes(), Path.write_bytes

    def half_then_full(self: Path, content: bytes) -> int:
        write(self, content[: len(content) // 2])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", half_then_full)
    with pytest.raises(OSError, match="No space left"):
        WholeCheckpoints({}, tmp_path).save_checkpoint({"weights": torch.zeros(3)}, path)
    assert [file.read_bytes() for file in path.parent.iterdir()] == [before]


def test_a_checkpoint_runs_no_code(tmp_path: Path) -> None:
    path, victim = tmp_path / "best.ckpt", tmp_path / "code_ran"
    torch.save({"state_dict": {}, "hook": RunsCode(victim)}, path)
    with pytest.raises(CophyError, match=r"best\.ckpt is not a checkpoint of train\.py"):
        WholeCheckpoints({}, tmp_path).load_checkpoint(path)
    with pytest.raises(CophyError, match=r"best\.ckpt is not a checkpoint of train\.py"):
        read_checkpoint(path.read_bytes(), path)
    assert not victim.exists()


def test_only_checkpoints_of_the_run_are_removed(tmp_path: Path) -> None:
    own, elsewhere, other = tmp_path / "run" / "best.ckpt", tmp_path / "best.ckpt", tmp_path / "run" / "notes.txt"
    own.parent.mkdir()
    for path in (own, elsewhere, other):
        path.touch()
        WholeCheckpoints({}, own.parent).remove_checkpoint(path)
    WholeCheckpoints({}, own.parent).remove_checkpoint(own.parent / ".." / "best.ckpt")
    assert [path.exists() for path in (own, elsewhere, other)] == [False, True, True]


def test_a_flipped_byte_is_noticed_or_changes_nothing(tmp_path: Path) -> None:
    path, rng = tmp_path / "best.ckpt", np.random.default_rng(0)
    checkpoint = {"state_dict": torch.arange(300.0), "loops": 3}
    WholeCheckpoints({}, tmp_path).save_checkpoint(checkpoint, path)
    content, noticed = path.read_bytes(), 0
    start = content.index(torch.arange(300.0).numpy().tobytes())
    for place in [start + 5, *rng.integers(0, len(content), 150).tolist()]:
        path.write_bytes(content[:place] + bytes([content[place] ^ 64]) + content[place + 1 :])
        try:
            loaded = WholeCheckpoints({}, tmp_path).load_checkpoint(path, weights_only=True)
        except CophyError:
            noticed += 1
        else:
            assert place != start + 5
            assert loaded.keys() == checkpoint.keys() | {"callbacks", "pytorch-lightning_version"}
            assert torch.equal(loaded["state_dict"], checkpoint["state_dict"])
    assert noticed > 50


def test_a_file_larger_than_any_checkpoint_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "best.ckpt"
    path.touch()
    os.truncate(path, 2**40)  # a sparse file
    with pytest.raises(CophyError, match=r"best\.ckpt is not a checkpoint of train\.py: it is larger than 4 GiB"):
        read_file(path)


def compress(path: Path, to: Path) -> None:
    with zipfile.ZipFile(path) as stored, zipfile.ZipFile(to, "w", zipfile.ZIP_DEFLATED) as archive:
        for entry in stored.infolist():
            archive.writestr(entry.filename, stored.read(entry))


def overlap(path: Path, to: Path) -> None:
    """List every part of the checkpoint a hundred times, but store it once."""
    to.write_bytes(path.read_bytes())
    with zipfile.ZipFile(to, "a") as archive:
        archive.filelist *= 100
        archive._didModify = True


@pytest.mark.parametrize("grow", [compress, overlap])
def test_a_file_that_would_grow_when_read_is_refused(tmp_path: Path, grow: Callable[[Path, Path], None]) -> None:
    WholeCheckpoints({}, tmp_path).save_checkpoint({"weights": torch.zeros(3000)}, tmp_path / "best.ckpt")
    grow(tmp_path / "best.ckpt", tmp_path / "grows.ckpt")
    with pytest.raises(CophyError, match=r"grows\.ckpt .* compressed, or its parts overlap"):
        WholeCheckpoints({}, tmp_path).load_checkpoint(tmp_path / "grows.ckpt", weights_only=True)


def contain_itself() -> dict[str, Any]:
    tree: dict[str, Any] = {}
    tree["inner"] = tree
    return tree


def double(times: int) -> list[Any]:
    """Return a few lists in memory with 2 to the power of `times` values."""
    tree: list[Any] = [1]
    for _ in range(times):
        tree = [tree, tree]
    return tree


def test_a_configuration_is_plain() -> None:
    check_plain_values({"a": {"b": [1, 2.5, True, None, "#00ff00"], "c": {}}, "d": [], "e": -(2**63) + 1})


@pytest.mark.parametrize(
    ("tree", "message"),
    [
        (contain_itself(), "nested more than 10 deep, or contain themselves"),
        ([double(8)] * 1000, "more than 100,000 values"),
        ([None] * (MAX_VALUES + 1), "more than 100,000 values"),
        ({1: 2}, "a key is not a name"),
        ((1, 2), "tuple is not a type"),
        (["${oc.env:HOME}"], "is a reference"),
        ({"${oc.env:HOME}": 1}, "is a reference"),
    ],
)
def test_what_no_configuration_holds_is_refused(tree: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        check_plain_values([tree])


@pytest.mark.parametrize(
    "state", [{1: torch.ones(3)}, {"a": "text"}, "weights", None], ids=["no name", "text", "no dict", "none"]
)
def test_weights_that_are_not_tensors_by_name_are_refused(tmp_path: Path, state: object) -> None:
    torch.save({"origin": {}, "state_dict": state}, tmp_path / "a.ckpt")
    with pytest.raises(CophyError, match=r"a\.ckpt is not a checkpoint of train\.py: it has no weights"):
        read_checkpoint(read_file(tmp_path / "a.ckpt"), tmp_path / "a.ckpt")


class Keep(nn.Module):
    """Keeps its argument."""

    def __init__(self, *, value: object) -> None:
        super().__init__()
        self.value = value


class Fail(nn.Module):
    """Raises a TypeError of its own."""

    def __init__(self, size: int = 4) -> None:
        super().__init__()
        self.size = len(size)  # type: ignore[arg-type]


class NeedValues(nn.Module):
    """Reads a number from a tensor, which the meta device cannot do: it raises a RuntimeError there."""

    def __init__(self) -> None:
        super().__init__()
        self.layer = nn.Linear(int(torch.tensor(3).item()), 2)


def test_a_model_without_a_class_is_refused() -> None:
    with pytest.raises(CophyError, match="_target_ is missing"):
        build_network({"hidden_dim": 32})


def test_nothing_nested_is_built() -> None:
    nested = {"_target_": "pathlib.Path", "_args_": ["hacked"]}
    assert build_network({"_target_": f"{__name__}.Keep", "value": nested}).value == nested


@pytest.mark.parametrize("special", ["_args_", "_partial_", "_recursive_", "_convert_", 5])
def test_keys_that_hydra_would_obey_are_refused(special: object) -> None:
    with pytest.raises(CophyError, match=f"model.{special} is not an argument of a network"):
        build_network({"_target_": "cophy.models.baselines.CopyC", special: True})


def test_an_unknown_argument_is_an_error_of_the_user() -> None:
    with pytest.raises(CophyError, match=r"model: .*'more'; see .*\.Fail"):
        build_network({"_target_": f"{__name__}.Fail", "more": 1})


def test_a_type_error_inside_a_users_model_keeps_its_traceback() -> None:
    with pytest.raises(TypeError, match="object of type 'int' has no len") as caught:
        build_network({"_target_": f"{__name__}.Fail"})
    assert caught.traceback[-1].path == Path(__file__)


def test_an_error_while_a_users_module_is_imported_keeps_its_traceback(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "broken_model.py").write_text("import json\njson.nonsense\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(AttributeError, match="nonsense"):
        build_network({"_target_": "broken_model.Net"})


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ("nowhere.Net", "no module nowhere"),
        ("cophy.models.nowhere.Net", "no module cophy.models.nowhere"),
        ("cophy.models.cophynet.Nobody", "has no Nobody"),
        ("os.path.join", "is not a torch.nn.Module"),
        ("Net", "cannot be imported"),
    ],
)
def test_a_class_that_does_not_exist_is_named(target: str, message: str) -> None:
    with pytest.raises(CophyError, match=message):
        build_network({"_target_": target})


def tensors_of(network: nn.Module) -> list[Tensor]:
    return [*network.parameters(), *network.buffers()]


def restored(model: dict[str, Any], weights: dict[str, Tensor]) -> nn.Module:
    return restore_network(Checkpoint({"model": model}, weights, has_optimizer=False), SOURCE)


@pytest.mark.parametrize(
    "choice",
    ["cophynet", "cophynet ablation=mlp", "cophynet ablation=single_step", "in", "npe", "alongside", "copy_c"]
    + [f"derenderer model.readout={readout}" for readout in ("attention", "linear")],
)
def test_a_restored_network_is_the_one_that_was_saved(choice: str) -> None:
    """Buffers that are not saved are the same too."""
    model = model_of(*f"model={choice}".split())
    network = build_network(model)
    for saved_tensor, tensor in zip(
        tensors_of(network), tensors_of(restored(model, network.state_dict())), strict=True
    ):
        assert torch.equal(saved_tensor, tensor)


def test_a_restored_network_has_single_precision_whatever_the_callers_default_is() -> None:
    model = model_of("model=in")
    weights = build_network(model).state_dict()
    torch.set_default_dtype(torch.float64)
    try:
        tensors = tensors_of(restored(model, weights))
    finally:
        torch.set_default_dtype(torch.float32)
    assert {tensor.dtype for tensor in tensors if tensor.is_floating_point()} == {torch.float32}


def wide(hidden_dim: int) -> dict[str, Any]:
    return model_of("model=in") | {"hidden_dim": hidden_dim}


@pytest.mark.parametrize(("hidden_dim", "message"), [(10**9, "is more than 16384"), (2**14, "does not fit")])
def test_weights_are_compared_before_memory_is_allocated(
    hidden_dim: int, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    few, devices = build_network(wide(8)).state_dict(), []
    monkeypatch.setattr(nn.Linear, "reset_parameters", lambda layer: devices.append(layer.weight.device.type))
    with pytest.raises(CophyError, match=message):
        restored(wide(hidden_dim), few)
    assert set(devices) <= {"meta"}


@pytest.mark.parametrize("place", ["state_dict", "optimizer_states", "callbacks"])
@pytest.mark.parametrize("device", ["cpu", "meta"])
def test_tensors_that_repeat_a_number_are_refused(tmp_path: Path, place: str, device: str) -> None:
    path = tmp_path / "last.ckpt"
    torch.save({place: {"a": [(torch.zeros(1, device=device).expand(2**40),)]}}, path)
    with pytest.raises(CophyError, match=r"last\.ckpt .*its tensors repeat a few numbers"):
        WholeCheckpoints({}, tmp_path).load_checkpoint(path)


@pytest.mark.parametrize("value", [OrderedDict, torch._utils._rebuild_tensor_v2])
def test_a_function_or_class_is_no_data(tmp_path: Path, value: object) -> None:
    """PyTorch loads a few of them; a schedule restored from a dict would call what the dict names `get_lr`."""
    path = tmp_path / "last.ckpt"
    torch.save({"lr_schedulers": [{"get_lr": value}]}, path)
    with pytest.raises(CophyError, match=r"last\.ckpt .* is not a type of data"):
        WholeCheckpoints({}, tmp_path).load_checkpoint(path)


def test_only_what_a_training_continues_from_is_restored(tmp_path: Path) -> None:
    path, anything = tmp_path / "last.ckpt", {"dirpath": "http://127.0.0.1/best.ckpt"}
    kept = {**{key: {"a": 1} for key in RESTORED}, "callbacks": {"Stopwatch": {"seconds": 3.0}}}
    more = {"callbacks": {**kept["callbacks"], "ModelCheckpoint{}": anything, "Unknown": anything}}
    names = ("CounterfactualDataModule", "hyper_parameters", "hparams_name", "pytorch-lightning_version", "epoch")
    torch.save({**kept, **dict.fromkeys(names, anything), **more}, path)
    loaded = WholeCheckpoints({}, tmp_path, {"Stopwatch", "GradientNorm"}).load_checkpoint(path)
    assert loaded == {**kept, "pytorch-lightning_version": lightning.__version__}


def test_classes_of_other_packages_are_not_restored() -> None:
    with pytest.raises(CophyError, match=r"whose code runs only if you name it"):
        restored({"_target_": f"{__name__}.Keep", "value": 1}, {})


@pytest.mark.parametrize("lacks", [(), ("format",), ("format", "seed", "trainer", "source")])
def test_checkpoints_of_data_of_earlier_formats_are_refused(lacks: tuple[str, ...], tmp_path: Path) -> None:
    """Format 3 is that of checkpoints that do not state theirs."""
    model = model_of("model=in")
    path = saved(tmp_path / "earlier.ckpt", model, weights_of(model), format=3)
    content = torch.load(path, weights_only=True)
    for key in lacks:
        del content["origin"][key]
    torch.save(content, path)
    now = rf"now {FORMAT_VERSION}\): train it again \(docs/reference/upgrading\.md\)"
    with pytest.raises(CophyError, match=rf"earlier\.ckpt was trained by an earlier version \(data of format 3, {now}"):
        read_checkpoint(read_file(path), path)


def test_the_format_of_generated_data_does_not_matter_to_released_data(tmp_path: Path) -> None:
    model = model_of("model=in")
    path = saved(tmp_path / "released.ckpt", model, weights_of(model), format=3, source={"name": "cophy"})
    assert read_checkpoint(read_file(path), path).origin["model"] == model


def test_a_checkpoint_with_a_format_states_all_keys(tmp_path: Path) -> None:
    model = model_of("model=in")
    path = saved(tmp_path / "partial.ckpt", model, weights_of(model))
    content = torch.load(path, weights_only=True)
    del content["origin"]["seed"]
    torch.save(content, path)
    with pytest.raises(CophyError, match=r"partial\.ckpt .*\(key seed is missing or unknown\)"):
        read_checkpoint(read_file(path), path)


def test_checkpoints_of_earlier_versions_are_of_the_mse(tmp_path: Path) -> None:
    """They do not state their loss."""
    model, training = model_of("model=in"), to_plain(composed("train", "scenario=balls"))["training"]
    weights = weights_of(model)
    now = saved(tmp_path / "now.ckpt", model, weights, seed=0)
    del training["loss"]
    earlier = saved(tmp_path / "earlier.ckpt", model, weights, seed=0, training=training)
    huber = saved(tmp_path / "huber.ckpt", model, weights, seed=0, training=training | {"loss": {"_target_": "a.b"}})
    check_trained(earlier, read_checkpoint(read_file(now), now).origin, build_network(model))
    with pytest.raises(CophyError, match=r"belongs to another training \(training\.loss\._target_=a\.b\)"):
        check_trained(huber, read_checkpoint(read_file(now), now).origin, build_network(model))


@pytest.mark.parametrize("check", [check_resumable, check_trained])
@pytest.mark.parametrize("target", [f"{__name__}.NeedValues", "cophy.models.baselines.InteractionNetwork"])
def test_weights_of_other_shapes_are_named(
    tmp_path: Path, check: Callable[[Path, dict[str, Any], nn.Module], None], target: str
) -> None:
    model = model_of("model=in") if target.startswith("cophy.") else {"_target_": target}
    weights = weights_of(model)

    def check_with(name: str, weights: dict[str, Tensor]) -> None:
        path = saved(tmp_path / name, model, weights, seed=0)
        torch.save(torch.load(path, weights_only=True) | {"optimizer_states": []}, path)
        check(path, read_checkpoint(read_file(path), path).origin, build_network(model))

    check_with("whole.ckpt", weights)
    name = min(weights)
    with pytest.raises(CophyError, match=rf"cut\.ckpt .*\({re.escape(name)} does not fit {target}"):
        check_with("cut.ckpt", weights | {name: weights[name][:1]})
