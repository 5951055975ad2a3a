"""Settings of the moment-corrected scheme."""

from typing import Annotated, Literal

from pydantic import Field

from .config import Count, Positive, settings

__all__ = ["CorrectedScheme"]


@settings
class CorrectedScheme:
    """Summation SPH in whitened coordinates whose velocities satisfy the moment equations.

    Attributes
    ----------
    kernel : str
    support : float
        K h in units of the particle spacing.
    degree : int
        Degree of the polynomial correction, lower where there are less than ten particles a polynomial; 0 is
        plain SPH.
    tol : float
        Error allowed in a time step: root mean square over the mass, in standard deviations of the cloud.
    max_steps : int
        Steps of one prediction after which it is given up with an error.
    """

    kernel: Literal["gaussian", "lucy", "cubic", "wendland_c2", "wendland_c4"] = "wendland_c2"
    support: Positive = 3.5
    degree: Annotated[int, Field(ge=0, le=6)] = 4
    tol: Positive = 1e-4
    max_steps: Count = 20_000

    name = "corrected"
