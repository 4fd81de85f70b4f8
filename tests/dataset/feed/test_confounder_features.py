"""True confounders as a network is given them."""

import torch

from cophy.dataset.features import confounder_features, confounder_statistics, standardised
from cophy.types import CONFOUNDERS, HORIZONTAL


def test_confounders_are_standardised_over_present_objects(tiny) -> None:
    _, arrays = tiny
    raw, presence = confounder_features(arrays), torch.from_numpy(arrays["presence"][:, 0])
    features = standardised(raw, presence, confounder_statistics(raw, presence))
    values, before = features[presence], raw[presence]
    horizontal = [column for pair in HORIZONTAL for column in pair]
    scalars = [column for column in range(len(CONFOUNDERS)) if column not in horizontal]
    varies = (before.std(dim=0) > 0).float()
    torch.testing.assert_close(values.mean(dim=0)[scalars], torch.zeros(len(scalars)), atol=1e-5, rtol=0)
    torch.testing.assert_close(values.std(dim=0)[scalars], varies[scalars], atol=1e-5, rtol=0)
    for pair in HORIZONTAL:  # one scale for both components, so that directions stay what they are
        size = values[:, pair].square().mean().sqrt()
        torch.testing.assert_close(size, before[:, pair].any().float(), atol=1e-5, rtol=0)
    assert not features[~presence].any()
