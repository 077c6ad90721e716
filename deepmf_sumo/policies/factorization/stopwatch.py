"""Wall time of the parts of a plan."""

import time


class Stopwatch:
    """Wall time by part."""

    def __init__(self) -> None:
        self._since = time.perf_counter()
        self.milliseconds: dict[str, float] = {}

    def lap(self, part: str) -> None:
        """Add the time since the last lap to a part."""
        now = time.perf_counter()
        spent = 1000 * (now - self._since)
        self.milliseconds[part] = self.milliseconds.get(part, 0.0) + spent
        self._since = now

    @property
    def seconds(self) -> float:
        """Sum of all laps."""
        return sum(self.milliseconds.values()) / 1000
