"""Which optional inputs the configuration of a model declares: all others never reach it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class DeclaredInputs:
    """The optional fields of `cophy.types.Inputs`, by name, and whether a model is given them."""

    confounders: bool = False
    object_type: bool = False
    pose: bool = False

    @classmethod
    def of(cls, model: Mapping[str, Any]) -> "DeclaredInputs":
        """What the keys of a model (conf/model/, or a checkpoint) declare; a model without such keys gets none of them."""
        return cls(
            confounders=model.get("confounders") == "ground_truth",
            object_type=model.get("object_type") is True,
            pose=model.get("pose") is True,
        )

    @property
    def not_derendered(self) -> str:
        """The keys that ask for what objects look like, which no de-renderer estimates; empty where there are none."""
        wanted = {"model.object_type=true": self.object_type, "model.pose=true": self.pose}
        return " and ".join(key for key, given in wanted.items() if given)
