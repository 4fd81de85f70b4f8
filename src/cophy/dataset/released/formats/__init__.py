"""The released formats, and `FORMATS`, which finds them by name.

cophy_224: CoPhy_224, the dataset of the paper.
cophy_tasks: what differs between the three tasks of CoPhy_224, as data; the export uses it too.
filtered_cophy: Filtered-CoPhy (CoPhy_112), the dataset of the successor.
columns: what both read alike: columns of states.npy, colours and clips.
"""

from cophy.dataset.released.formats.cophy_224 import CoPhy
from cophy.dataset.released.formats.filtered_cophy import FilteredCoPhy
from cophy.dataset.released.protocol import ReleasedFormat

FORMATS: dict[str, ReleasedFormat] = {known.name: known for known in (CoPhy(), FilteredCoPhy())}
