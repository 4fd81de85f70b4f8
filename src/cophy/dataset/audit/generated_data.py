"""All that can be checked of data that were generated here."""

from collections.abc import Iterator

from cophy.dataset.audit.balance import shapes, shares, trajectories
from cophy.dataset.audit.bias.shortcuts import bias
from cophy.dataset.audit.checks import Arrays, Check
from cophy.dataset.audit.do_operations_matter import do_operations_matter
from cophy.dataset.audit.first_frames import geometries
from cophy.dataset.audit.rigid_bodies import states
from cophy.dataset.audit.simulated.convergence import convergence
from cophy.dataset.audit.simulated.identifiability import identifiability
from cophy.dataset.audit.simulated.resimulation import simulation
from cophy.dataset.audit.tower_outcomes import towers
from cophy.dataset.audit.twin_pairs import twins
from cophy.dataset.spec import DatasetSpec


def audit_generated(arrays: Arrays, spec: DatasetSpec, *, replayed_pairs: int) -> Iterator[Check]:
    """All checks on a loaded dataset; loading it has already verified every checksum.

    Args:
        arrays: of the whole dataset.
        spec: of the dataset.
        replayed_pairs: how many twin pairs are made and simulated again, and under other confounders.
    """
    yield from states(arrays, spec)
    yield from twins(arrays, spec)
    yield from do_operations_matter(arrays, spec)
    yield from geometries(arrays, spec.num_objects)
    yield from shares(arrays, spec)
    if spec.scenario.statics is not None:
        yield from towers(arrays, spec, spec.scenario.statics)
    else:
        yield from shapes(arrays, spec)
        yield from trajectories(arrays, spec)
    yield from bias(arrays, spec)
    yield from simulation(arrays, spec, replayed_pairs)
    yield from convergence(arrays, spec, replayed_pairs)
    yield from identifiability(arrays, spec, replayed_pairs)
    simulations = arrays["pair_simulations"][::2].sum() / len(arrays["twin"])
    yield Check("simulations per experiment", f"{simulations:.2f}", True)
