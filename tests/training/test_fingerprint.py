"""Which trainings are the same: the fingerprint, and what is found in a run's directory."""

import json
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from lightning.pytorch.callbacks import EarlyStopping
from torch import nn

from cophy.config import composed, to_plain
from cophy.errors import CophyError
from cophy.models.baselines import CopyC
from cophy.training import reuse
from cophy.training.checkpoints import make_origin
from cophy.training.instantiation import instantiate_function, instantiate_key
from cophy.training.losses import MSE
from cophy.training.reuse import fingerprint, hash_code, record_finished, start_training
from cophy.training.run import Run
from tests.conftest import refused
from tests.models.networks import build
from tests.training.saved import model_of, saved

PLAIN = to_plain(composed("train"))
CHECKSUMS = {"3-tiny": {"0.h5": "abc"}}


def origin_of(**trainer: Any) -> dict[str, Any]:
    return make_origin(PLAIN | {"trainer": PLAIN["trainer"] | trainer}, ["3-tiny"])


ORIGIN = origin_of()


def fingerprint_of(origin: dict[str, Any] = ORIGIN, **changes: Any) -> str:
    return fingerprint(origin, **{"max_epochs": 40, "threads": 1, "code": "code", "checksums": CHECKSUMS} | changes)


@pytest.mark.parametrize("changes", [{"enable_progress_bar": False}, {"limit_test_batches": 1}])
def test_what_changes_no_weight_does_not_count(changes: dict[str, Any]) -> None:
    assert fingerprint_of(origin_of(**changes)) == fingerprint_of()
    assert fingerprint_of(ORIGIN | {"split": {"name": "3to4"}}) == fingerprint_of()  # only tested on


def test_what_changes_weights_counts() -> None:
    others = [
        fingerprint_of(ORIGIN | {"trained_on": ["4-tiny"]}),
        fingerprint_of(ORIGIN | {"model": {**ORIGIN["model"], "hidden_dim": 8}}),
        fingerprint_of(ORIGIN | {"training": {**ORIGIN["training"], "learning_rate": 1.0}}),
        fingerprint_of(ORIGIN | {"seed": 1}),
        fingerprint_of(origin_of(gradient_clip_val=0.5)),
        fingerprint_of(max_epochs=1),
        fingerprint_of(threads=2),
        fingerprint_of(code="edited"),
        fingerprint_of(checksums={"3-tiny": {"0.h5": "other"}}),
    ]
    assert len({fingerprint_of(), *others}) == 10


def test_the_weights_that_a_training_starts_from_count_and_their_name_does_not(tmp_path: Path) -> None:
    paths = [tmp_path / name for name in ("best.ckpt", "copy_of_best.ckpt", "last.ckpt")]
    for path, text in zip(paths, ("weights", "weights", "others"), strict=True):
        path.write_text(text)
    best, copy, last = (fingerprint_of(resumed_from=path) for path in paths)
    assert best == copy
    assert len({fingerprint_of(), best, last}) == 3


def edit(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a file of the package read as if it had been edited."""
    edited, read = reuse.PACKAGE / name, Path.read_bytes
    assert edited.is_file()
    monkeypatch.setattr(Path, "read_bytes", lambda path: read(path) + (b"\n# edited" if path == edited else b""))


@pytest.fixture(scope="module")
def hash_of_gns() -> str:
    return hash_code(build("gns"))


@pytest.mark.parametrize(
    ("name", "counts"),
    [
        *(("training/losses.py", True), ("dataset/splits.py", True), ("types.py", True), ("models/gns.py", True)),
        ("models/contacts.py", True),  # GNS imports it
        *(("models/alongside.py", False), ("cli.py", False)),
    ],
)
def test_an_edit_counts_only_where_weights_depend_on_it(
    name: str, counts: bool, hash_of_gns: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    edit(name, monkeypatch)
    assert (hash_code(build("gns")) != hash_of_gns) == counts


def test_a_model_within_a_model_of_the_user_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Hydra may have passed it to a class that does not import it."""
    network = nn.Sequential(build("transformer"))
    before = hash_code(network)
    edit("models/transformer.py", monkeypatch)
    assert hash_code(network) != before


@pytest.mark.parametrize(
    ("line", "counts"),
    [
        *(("from cophy.models.transformer import Transformer", True), ("import cophy.models.transformer", True)),
        *(("from cophy.models import Transformer", True), ("import cophy.models", True)),
        *(("from cophy.models.layers import mlp", False), ("import torch", False)),
    ],
)
def test_models_that_a_model_of_the_user_imports_count(
    line: str, counts: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "users_model.py").write_text(f"{line}\nclass Net: ...\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    network = __import__("users_model").Net()
    before = hash_code(network)
    edit("models/transformer.py", monkeypatch)
    assert (hash_code(network) != before) == counts
    del sys.modules["users_model"]


def test_modules_next_to_a_model_of_the_user_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "users_model.py").write_text("class Net: ...\n")
    (tmp_path / "helper.py").write_text("SCALE = 1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    module: ModuleType = __import__("users_model")
    before = hash_code(module.Net())
    (tmp_path / "helper.py").write_text("SCALE = 2\n")
    assert hash_code(module.Net()) != before
    del sys.modules["users_model"]


def test_a_file_next_to_a_model_of_the_user_may_be_invalid(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "users_model.py").write_text("class Net: ...\n")
    (tmp_path / "draft.py").write_text("def unfinished(\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert hash_code(__import__("users_model").Net())
    del sys.modules["users_model"]


@pytest.mark.parametrize("decorator", ["", "import torch\n\n@torch.enable_grad()\n"])
def test_modules_next_to_a_loss_of_the_user_count(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, decorator: str
) -> None:
    (tmp_path / "users_loss.py").write_text(
        f"{decorator}def double(predicted, target, factor): return factor * (predicted - target)\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    loss = instantiate_function("training.loss", {"_target_": "users_loss.double", "factor": 2})
    before = hash_code(CopyC(), loss)
    assert before != hash_code(CopyC(), instantiate_function("training.loss", MSE))
    (tmp_path / "users_loss.py").write_text("def double(predicted, target, factor): return predicted - target\n")
    assert hash_code(CopyC(), loss) != before
    del sys.modules["users_loss"]


@pytest.fixture
def run(tmp_path: Path) -> Run:
    return make_run(tmp_path, "4to4")


def test_a_callback_and_a_schedule_of_the_user_count_and_those_of_libraries_do_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "mine.py"
    path.write_text("class Callback: ...\ndef schedule(optimizer, epochs): ...\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    callback = __import__("mine").Callback()
    schedule = instantiate_key("schedule=", {"_target_": "mine.schedule"}, _partial_=True)
    before = hash_code(CopyC()), hash_code(CopyC(), callback), hash_code(CopyC(), schedule)
    path.write_text(path.read_text() + "# edited\n")
    after = hash_code(CopyC()), hash_code(CopyC(), callback), hash_code(CopyC(), schedule)
    assert [one == other for one, other in zip(before, after, strict=True)] == [True, False, False]
    assert hash_code(CopyC(), EarlyStopping("val/mse")) == before[0]
    del sys.modules["mine"]


def test_a_loss_that_is_not_written_in_python_is_an_error_of_the_user() -> None:
    with pytest.raises(CophyError, match=r"training\.loss: no signature found"):
        instantiate_function("training.loss", {"_target_": "torch.nn.functional.pairwise_distance"})


def make_run(root: Path, split: str, variant: str = "") -> Run:
    run = Run("balls", split, "cophynet", "full", "ground_truth", 1, "tiny", variant, root)
    run.directory = root / run.place
    return run


def leave_checkpoints(run: Run, text: str = "weights") -> None:
    run.checkpoints.mkdir(parents=True, exist_ok=True)
    for name in ("best.ckpt", "last.ckpt"):
        (run.checkpoints / name).write_text(text)


FACTS = {"training_seconds": 3.0, "training_cpu_seconds": 2.0, "resumed": 0, "validation": {"val/mse": 1.0}}
CODE = {"code": "old"}


@pytest.mark.parametrize(("split", "variant"), [("4to3", ""), ("4to4", "+derenderer-x")])
def test_a_finished_training_is_found_in_a_run_with_another_test(
    split: str, variant: str, run: Run, tmp_path: Path
) -> None:
    leave_checkpoints(run)
    record_finished(run, "same", FACTS | CODE)
    other = make_run(tmp_path, split, variant)
    start = start_training(other, "same", reuse=True, ckpt=None, code="new")
    assert start == (FACTS, other.checkpoints / "best.ckpt", 0, False)
    assert (other.checkpoints / "best.ckpt").read_text() == "weights"
    assert start_training(make_run(tmp_path, "4to5"), "another", reuse=True, ckpt=None, code="new").finished is None
    assert start_training(other, "same", reuse=False, ckpt=None, code="new").finished is None


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("new", "other code (of cophy, or .py files next to your model, loss, callback, optimizer or schedule)"),
        ("old", "other data or settings, or another version of torch"),
    ],
)
def test_a_finished_training_is_not_made_again_without_a_word(
    code: str, said: str, run: Run, caplog: pytest.LogCaptureFixture
) -> None:
    message = f"the results in {run.directory} come from {said}: the model is trained again"
    for is_reused, messages in ((True, [message]), (False, [])):
        leave_checkpoints(run)
        record_finished(run, "same", FACTS | CODE)
        assert start_training(run, "another", reuse=is_reused, ckpt=None, code=code).finished is None
        assert caplog.messages == messages
        caplog.clear()


def test_an_interrupted_training_continues_only_with_the_same_fingerprint(run: Run) -> None:
    assert start_training(run, "same", reuse=True, ckpt=None, code="new") == (None, None, 0, False)
    for resumed in (1, 2):
        leave_checkpoints(run)
        assert start_training(run, "same", reuse=True, ckpt=None, code="new") == (
            *(None, run.checkpoints / "last.ckpt", resumed, True),
        )
    assert start_training(run, "another", reuse=True, ckpt=None, code="new") == (None, None, 0, False)
    assert (run.checkpoints / "last_of_stopped.ckpt").read_text() == "weights"  # hours of work, perhaps


def test_a_training_stopped_before_its_first_validation_continues(run: Run) -> None:
    start_training(run, "same", reuse=True, ckpt=None, code="new")
    (run.checkpoints / "last.ckpt").write_text("weights")
    start = start_training(run, "same", reuse=True, ckpt=None, code="new")
    assert start == (None, run.checkpoints / "last.ckpt", 1, True)


def test_a_finished_training_that_is_used_again_removes_no_interrupted_one(run: Run, tmp_path: Path) -> None:
    start_training(run, "interrupted", reuse=True, ckpt=None, code="new")
    leave_checkpoints(run, "interrupted")
    other = make_run(tmp_path, "4to3")
    leave_checkpoints(other)
    record_finished(other, "same", FACTS | CODE)
    assert start_training(run, "same", reuse=True, ckpt=None, code="new").finished == FACTS
    assert (run.checkpoints / "best.ckpt").read_text() == "weights"
    assert (run.checkpoints / "last_of_stopped.ckpt").read_text() == "interrupted"


@pytest.mark.parametrize("name", ["last.ckpt", "last_of_stopped.ckpt", "mine.ckpt"])
def test_a_checkpoint_continues_with_the_best_of_its_own_training(
    name: str, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reuse, "is_of_one_training", lambda *paths: True)
    leave_checkpoints(run, "weights")
    start_training(run, "one", reuse=True, ckpt=None, code="new")  # removes them
    leave_checkpoints(run, "interrupted")
    start_training(run, "another", reuse=True, ckpt=None, code="new")  # renames them
    leave_checkpoints(run, "of another")
    record_finished(run, "another", FACTS | CODE)
    (run.checkpoints / "mine.ckpt").write_text("of another")
    start_training(run, "third", reuse=True, ckpt=run.checkpoints / name, code="new")
    expected = "interrupted" if name == "last_of_stopped.ckpt" else "of another"
    assert (run.checkpoints / "best.ckpt").read_text() == expected


@pytest.mark.parametrize("seed", [0, 1])
def test_the_best_of_another_training_next_to_a_checkpoint_is_left_alone(seed: int, run: Run, tmp_path: Path) -> None:
    model = model_of("model.hidden_dim=8")
    ckpt = saved(tmp_path / "last_of_balls.ckpt", model, {}, seed=0)
    saved(tmp_path / "best.ckpt", model, {}, seed=seed)
    start_training(run, "same", reuse=True, ckpt=ckpt, code="new")
    assert (run.checkpoints / "best.ckpt").exists() == (seed == 0)


def test_an_interrupted_training_never_replaces_the_checkpoint_that_is_resumed(run: Run) -> None:
    for name in ("one", "another"):
        start_training(run, name, reuse=True, ckpt=None, code="new")
        leave_checkpoints(run, name)
    start_training(run, "third", reuse=True, ckpt=None, code="new")
    leave_checkpoints(run, "third")
    older = run.checkpoints / "last_of_stopped.ckpt"
    with pytest.raises(CophyError, match="move one of them elsewhere"):
        start_training(run, "fourth", reuse=True, ckpt=older, code="new")
    assert (older.read_text(), (run.checkpoints / "last.ckpt").read_text()) == ("another", "third")


def test_a_damaged_note_of_another_run_stops_nothing(run: Run, tmp_path: Path) -> None:
    other = make_run(tmp_path, "4to3")
    leave_checkpoints(other)
    (other.checkpoints / "finished.json").write_text("{")
    assert start_training(run, "same", reuse=True, ckpt=None, code="new").checkpoint is None


def test_a_damaged_note_is_named_and_its_checkpoints_are_kept(run: Run) -> None:
    leave_checkpoints(run)
    record_finished(run, "same", FACTS | CODE)
    path = run.checkpoints / "finished.json"
    path.write_text(path.read_text()[:9])
    with pytest.raises(CophyError, match=r"finished\.json is damaged"):
        start_training(run, "same", reuse=True, ckpt=None, code="new")
    assert (run.checkpoints / "best.ckpt").read_text() == "weights"


@pytest.mark.parametrize("name", ["best.ckpt", "last.ckpt"])
@pytest.mark.parametrize("split", ["4to4", "4to3"])
def test_a_training_without_both_checkpoints_is_not_finished(name: str, split: str, run: Run, tmp_path: Path) -> None:
    leave_checkpoints(run)
    record_finished(run, "same", FACTS | CODE)
    (run.checkpoints / name).unlink()
    start = start_training(make_run(tmp_path, split), "same", reuse=True, ckpt=None, code="new")
    assert (start.finished, start.checkpoint) == (None, None)


@pytest.mark.parametrize(
    ("name", "changes", "wrong"),
    [
        ("finished.json", {"fingerprint": 1}, "fingerprint"),
        ("finished.json", {"training_seconds": "3", "validation": []}, "training_seconds, validation"),
        ("finished.json", {"resumed": None}, "resumed"),
        ("begun.json", {"fingerprint": None}, "fingerprint"),
        ("begun.json", {"resumed": "twice"}, "resumed"),
    ],
)
def test_a_note_with_values_of_wrong_types_is_named(name: str, changes: dict[str, Any], wrong: str, run: Run) -> None:
    leave_checkpoints(run)
    note = (
        {"fingerprint": "same", **FACTS, **CODE} if name == "finished.json" else {"fingerprint": "same", "resumed": 0}
    )
    (run.checkpoints / name).write_text(json.dumps(note | changes))
    with refused(f"{name} has no valid {wrong}: delete it to train again"):
        start_training(run, "same", reuse=True, ckpt=None, code="new")
    assert (run.checkpoints / "best.ckpt").read_text() == "weights"


def test_a_note_that_may_not_be_read_does_not_mean_never_trained(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    leave_checkpoints(run)
    record_finished(run, "same", FACTS | CODE)

    def refuse(path: Path) -> bytes:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(reuse, "read_json", refuse)
    with pytest.raises(PermissionError):
        start_training(run, "same", reuse=True, ckpt=None, code="new")
    assert (run.checkpoints / "best.ckpt").read_text() == "weights"
