"""Is a dataset what it claims to be?

generated_data: all checks of generated data, in the order of the report.
released_data: the checks that apply to data of others.
checks: one line of an audit, and how far a share may be off.
rigid_bodies: states are those of rigid bodies in this scene.
twin_pairs: twins share all but confounders.
do_operations_matter: D is another than B.
first_frames: no first frame of one split looks like one of another.
balance: cells, do-operations and confounder values are level.
tower_outcomes: what only towers have: labels, and outcomes balanced for every confounder.
simulated/: a sample is made again, simulated again, and simulated under other confounders.
bias/: what can be known of D without the motion of AB?
"""

from cophy.dataset.audit.checks import Check, ClassifierCheck
from cophy.dataset.audit.generated_data import audit_generated
from cophy.dataset.audit.released_data import audit_released

__all__ = ["Check", "ClassifierCheck", "audit_generated", "audit_released"]
