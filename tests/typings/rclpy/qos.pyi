from enum import Enum

class HistoryPolicy(Enum):
    KEEP_LAST = 1

class ReliabilityPolicy(Enum):
    RELIABLE = 1
    BEST_EFFORT = 2

class DurabilityPolicy(Enum):
    TRANSIENT_LOCAL = 1
    VOLATILE = 2

class QoSProfile:
    def __init__(
        self,
        *,
        history: HistoryPolicy = ...,
        depth: int = ...,
        reliability: ReliabilityPolicy = ...,
        durability: DurabilityPolicy = ...,
    ) -> None: ...
