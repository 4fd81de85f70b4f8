"""What a study is: its size, its clock, and a name that follows from both and from the data."""

import hashlib
import json
from dataclasses import asdict, dataclass

SETTINGS = ("non_cf", "cf")  # C alone; AB beside C
MIN_RESOLUTION, MAX_RESOLUTION = 64, 1024


@dataclass
class StudySettings:
    """What every participant of a study shares (conf/study.yaml explains the values).

    num_pairs: twin pairs of the test split that are shown. num_assignments: of each setting, per participant.
    seconds: to click. tolerance_s: how much later an answer may arrive. resolution: of the pictures, pixels.
    """

    seed: int
    num_pairs: int
    num_assignments: int
    seconds: float
    tolerance_s: float
    resolution: int

    def __post_init__(self) -> None:
        if self.num_assignments < 1 or self.num_pairs % self.num_assignments or self.num_pairs < self.num_per_person:
            raise ValueError(
                f"study.num_pairs={self.num_pairs} must be a multiple of study.num_assignments={self.num_assignments}, "
                "at least twice as large: nobody sees a pair in both settings"
            )
        if not (self.seconds > 0 and self.tolerance_s >= 0 and self.seed >= 0):
            raise ValueError("study: seconds must be positive, tolerance_s and seed must not be negative")
        check_resolution(self.resolution)

    @property
    def num_per_person(self) -> int:
        """Assignments of one participant, practice left out."""
        return len(SETTINGS) * self.num_assignments

    def study_id(self, data_id: str, split: str) -> str:
        """Name of a study: participants of another one are never counted with it.

        Args:
            data_id: Scenario and name of the dataset.
            split: Name of the split whose test half is shown.
        """
        text = json.dumps({"data": data_id, "split": split, **asdict(self)}, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:12]


def check_resolution(resolution: int) -> None:
    """Refuse pictures that are too small to be seen, or too large to be sent.

    Raises:
        ValueError: They are.
    """
    if not MIN_RESOLUTION <= resolution <= MAX_RESOLUTION:
        said = f"must be between {MIN_RESOLUTION} and {MAX_RESOLUTION} pixels"
        raise ValueError(f"study.resolution={resolution} {said}")


@dataclass
class Limits:
    """What one network address may ask of the server. requests_per_second; people_per_minute: who may begin."""

    requests_per_second: float
    people_per_minute: float

    def __post_init__(self) -> None:
        if self.requests_per_second < 1 or self.people_per_minute < 1:
            raise ValueError("limits: both must be at least 1")
