"""The README is complete."""

from tests.conftest import ROOT


def test_the_readme_names_every_choice() -> None:
    readme = (ROOT / "README.md").read_text()
    for group in ("scenario", "model", "ablation", "table"):
        for path in (ROOT / "conf" / group).iterdir():
            assert f"`{path.stem}`" in readme, f"{group}={path.stem}"
