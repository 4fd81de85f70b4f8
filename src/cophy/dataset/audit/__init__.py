"""Is a dataset what it claims to be?"""

from collections.abc import Iterator

from cophy.dataset.audit.bias import bias
from cophy.dataset.audit.check import Arrays, Check, ProbeCheck
from cophy.dataset.audit.external import audit_external
from cophy.dataset.audit.geometry import geometries
from cophy.dataset.audit.shares import shapes, shares, trajectories
from cophy.dataset.audit.simulation import simulation
from cophy.dataset.audit.states import states
from cophy.dataset.audit.towers import towers
from cophy.dataset.audit.twins import twins
from cophy.dataset.spec import DatasetSpec

__all__ = ["Check", "ProbeCheck", "audit", "audit_external"]


def audit(arrays: Arrays, spec: DatasetSpec, *, replayed_pairs: int) -> Iterator[Check]:
    """All checks on a loaded dataset (loading it has already verified every checksum).

    replayed_pairs: how many twin pairs are made and simulated again.
    """
    yield from states(arrays, spec)
    yield from twins(arrays, spec)
    yield from geometries(arrays, spec.num_objects)
    yield from shares(arrays, spec)
    if spec.scenario.name == "blocktower":
        yield from towers(arrays, spec)
    else:
        if spec.scenario.name == "collision":
            yield shapes(arrays, spec)
        yield from trajectories(arrays, spec)
    yield from bias(arrays, spec)
    yield from simulation(arrays, spec, replayed_pairs)
    simulations = arrays["pair_simulations"][::2].sum() / len(arrays["twin"])
    yield Check("simulations per experiment", f"{simulations:.2f}", True)
