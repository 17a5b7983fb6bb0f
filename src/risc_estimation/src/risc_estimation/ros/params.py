"""Parameters of the node beside those of the estimator."""

from dataclasses import dataclass
from typing import Tuple


@dataclass(frozen=True)
class NodeParams:
    """Settings of the node around the estimator; config/states_estimation.yaml explains and holds the same values."""

    vehicles: Tuple[str, ...] = ()  # vehicles that are listed before they are seen; empty = those of /fleet
    templates_file: str = ""  # marker templates; empty = config/templates.yaml of this package
    silence_s: float = 0.1  # [s] without frames before everything is declared invisible; 0 = never
    queue_frames: int = 400  # frames that may wait while the node is held up: 2 s at 200 Hz

    def __post_init__(self):
        if self.silence_s < 0.0:
            raise ValueError("silence_s must be 0 (off) or positive, got %r" % (self.silence_s,))
        if self.queue_frames < 1:
            raise ValueError("queue_frames must be at least 1, got %r" % (self.queue_frames,))
