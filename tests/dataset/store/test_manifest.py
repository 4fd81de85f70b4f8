"""Without a sound manifest nothing is read."""

import os
from pathlib import Path

import pytest

from cophy.dataset.shards import MANIFEST
from cophy.dataset.states import States
from cophy.errors import CophyError
from tests.dataset.copies import SPEC, copy


@pytest.mark.parametrize("content", ["{", "[" * 100_000], ids=["cut off", "nested deeply"])
def test_a_damaged_manifest_is_named_with_its_remedy(finished: Path, tmp_path: Path, content: str) -> None:
    directory = copy(finished, tmp_path)
    (directory / MANIFEST).write_text(content)
    with pytest.raises(CophyError, match=r"manifest\.json is damaged .* delete it and run"):
        States(SPEC, tmp_path).load()


def test_a_pipe_in_its_place_is_named(finished: Path, tmp_path: Path) -> None:
    directory = copy(finished, tmp_path)
    (directory / MANIFEST).unlink()
    os.mkfifo(directory / MANIFEST)
    with pytest.raises(CophyError, match=r"manifest\.json is damaged \(it is no plain file\): delete it and run"):
        States(SPEC, tmp_path).load()


def test_an_unfinished_dataset_is_not_loaded(tmp_path: Path) -> None:
    with pytest.raises(CophyError, match="is not finished: run"):
        States(SPEC, tmp_path).load()
