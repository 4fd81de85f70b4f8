import pytest

from cophy.scenario.rendering import Backend, RenderSettings


def test_settings_are_checked() -> None:
    with pytest.raises(ValueError, match="modalities"):
        RenderSettings(["rgb", "heat"], 64, Backend.tiny)
    with pytest.raises(ValueError, match="resolution=4 must"):
        RenderSettings(["rgb"], 4, Backend.tiny)
