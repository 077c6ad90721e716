"""Settings that all aimed attacks share."""

from pydantic import Field

from deepmf_sumo.adversaries.search.opponents import OpponentSettings
from deepmf_sumo.policies.factorization.settings import LIMITS
from deepmf_sumo.policies.factorization.tracking import Limits


class AimedSettings(OpponentSettings):
    """Whom to attack, how hard to drive, how often.

    Attributes:
        accel_mps2, brake_mps2, lateral_mps2: limits of what the opponent drives, DeepMF's.
        rounds: attacks that are driven, until one hits, where the budget says nothing.
    """

    accel_mps2: float = Field(default=LIMITS.accel, gt=0.0)
    brake_mps2: float = Field(default=LIMITS.brake, gt=0.0)
    lateral_mps2: float = Field(default=LIMITS.lateral, gt=0.0)
    rounds: int = Field(default=1, ge=1)

    @property
    def limits(self) -> Limits:
        """Limits of what the opponent drives."""
        return Limits(accel=self.accel_mps2, brake=self.brake_mps2, lateral=self.lateral_mps2)
