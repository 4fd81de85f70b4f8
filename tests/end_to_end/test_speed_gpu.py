"""`just bench gpu` measures what it says, tried on the CPU: a GPU is seldom at hand."""

import importlib
import math
from pathlib import Path

import pytest
import torch

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
SHARE = "time in kernels ÷ time"  # 0 on the CPU


@pytest.mark.slow
def test_every_way_of_training_is_measured_or_said_not_to_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    speed_gpu = importlib.import_module("speed_gpu")
    smaller = {
        "MODELS": ("alongside",),
        "BATCH_SIZES": (2,),
        "CPU_BATCH_SIZE": 2,
        "RENDERED": (32,),
        "DERENDERER_BATCHES": (2,),
        "REPEATS": 1,
        "SECONDS": 0.01,
    }
    for name, value in smaller.items():
        monkeypatch.setattr(speed_gpu, name, value)
    monkeypatch.setattr(torch, "compile", lambda network: network)  # compiling takes minutes
    rows = list(speed_gpu.measure("cpu"))
    failed = [row.what for row in rows if any(map(math.isnan, row.ratios)) and "egl" not in row.what]
    assert len(failed) == 2  # in two precisions: CUDA graphs need CUDA
    assert all(", graph: " in what for what in failed)
    assert all(
        ratio > 0
        for row in rows
        if row.unit != SHARE and row.what not in failed and "egl" not in row.what
        for ratio in row.ratios
    )
    kinds = {
        kind: sum(kind in row.what for row in rows)
        for kind in ("eager", "compiled", "de-renderer, 224 px", "one thread", "tiny")
    }
    assert kinds == {"eager": 4, "compiled": 1, "de-renderer, 224 px": 2, "one thread": 1, "tiny": 1}


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_without_a_gpu_one_line_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    with pytest.raises(SystemExit, match="no GPU with CUDA here"):
        next(importlib.import_module("speed_gpu").measure())
