"""What a model's keys declare."""

import pytest

from cophy.dataset.features import DeclaredInputs


@pytest.mark.parametrize(
    ("model", "declared"),
    [
        ({}, DeclaredInputs()),
        ({"confounders": "estimated", "object_type": False, "pose": False}, DeclaredInputs()),
        ({"confounders": None, "pose": "standing"}, DeclaredInputs()),  # a key of somebody's own
        ({"confounders": "ground_truth"}, DeclaredInputs(confounders=True)),
        ({"object_type": True, "pose": True}, DeclaredInputs(object_type=True, pose=True)),
    ],
)
def test_a_model_is_given_what_its_keys_say_and_nothing_else(model: dict, declared: DeclaredInputs) -> None:
    assert DeclaredInputs.of(model) == declared


def test_what_no_derenderer_estimates_is_named_by_its_key() -> None:
    assert DeclaredInputs(confounders=True).not_derendered == ""
    assert DeclaredInputs(pose=True).not_derendered == "model.pose=true"
    assert DeclaredInputs(object_type=True, pose=True).not_derendered == "model.object_type=true and model.pose=true"
