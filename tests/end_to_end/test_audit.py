"""Data that are damaged or wrong: who notices, and the remedy."""

from pathlib import Path

import h5py
import pytest

from cophy.audit import report
from tests.commands import run, train
from tests.dataset.copies import SPEC, copy


def audit(data: Path, **kwargs: int) -> str:
    where = (f"data_dir={data}", f"directory={data}/audit")
    return run("audit", "scenario=collision", "size=tiny", "replayed_pairs=1", *where, **kwargs)


@pytest.mark.slow
def test_a_damaged_shard_stops_training_with_its_remedy(tiny_data: Path, tmp_path: Path) -> None:
    shard = copy(SPEC.directory(tiny_data), tmp_path) / "shard-00001.h5"
    shard.write_bytes(shard.read_bytes()[:1000])
    printed = train("scenario=collision", f"hydra.run.dir={tmp_path / 'run'}", data=tmp_path, code=1)
    assert "shard-00001.h5 is damaged" in printed
    assert "run `python src/generate.py scenario=collision" in printed
    run("generate", "scenario=collision", "size=tiny", f"data_dir={tmp_path}")
    audit(tmp_path)
    (page,) = tmp_path.glob("audit/*/audit.md")
    assert "FAILS" not in page.read_text()
    assert all(page.with_name(f"{name}.png").stat().st_size > 10_000 for name in ("outcomes", "bias"))
    assert "lines hold (1 twin pairs" in shard.with_name("README.md").read_text()


def test_audit_names_what_is_wrong(tiny_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Consistent checksums do not save a dataset whose twins do not belong together."""
    for check in ("check_bias", "check_resimulation", "check_convergence", "check_identifiability"):  # these take long
        monkeypatch.setattr(report, check, lambda *_: ())
    shard = copy(SPEC.directory(tiny_data), tmp_path) / "shard-00000.h5"
    with h5py.File(shard, "r+") as file:
        file["split"][0] = 2 - file["split"][0]
    manifest = shard.with_name("manifest.json")
    manifest.unlink()
    run("generate", "scenario=collision", "size=tiny", f"data_dir={tmp_path}")  # vouches for what it finds
    printed = audit(tmp_path, code=1)
    assert "audit: 2-tiny" in printed
    assert "twins share everything except confounders: split" in printed
    assert "Traceback" not in printed
    (page,) = tmp_path.glob("audit/*/audit.md")
    assert page.read_text().count("FAILS") == printed.count("audit: ")
    assert "lines fail: " in shard.with_name("README.md").read_text()
    shard.write_bytes(shard.read_bytes()[:-100])
    printed = audit(tmp_path, code=1)
    assert "shard-00000.h5 is damaged (its checksum is not the one in manifest.json): run `python src/gen" in printed
    assert "Traceback" not in printed
