"""Default limits of a run, for the command line and for programs; imports nothing."""

from typing import Final

TIMEOUT_S: Final = 600.0
MEMORY_MB: Final = 4096.0
