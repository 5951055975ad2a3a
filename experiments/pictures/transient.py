"""The transient problems of 002: a scenario's model and start under the noise of Tables 1 to 3."""

from dataclasses import replace

import sphfilter as sf

__all__ = ["KERNEL", "SPECTRAL_DENSITY", "start_of", "transient_model"]

#: 2Ξ of 002 Tables 1, 2, 3. Tables 6 and 8 have a noise of 0.8 and 1.6 for the filters.
SPECTRAL_DENSITY = {"linear_underdamped": 0.2, "van_der_pol": 0.2, "duffing": 0.8}
#: 002 uses the Gaussian kernel unless it says otherwise (section 2.3.1).
KERNEL = "gaussian"


def transient_model(scenario):
    """The scenario's SDE with the noise of its transient problem."""
    noise = ((SPECTRAL_DENSITY[scenario.name],),)
    model = replace(scenario.settings.model, spectral_density=noise)
    return replace(scenario, settings=replace(scenario.settings, model=model)).model


def start_of(scenario):
    """Initial Gaussian of 002 Tables 1 to 3: that of the truth in the scenario."""
    return sf.Gaussian(scenario.settings.start.mean, scenario.settings.start.cov)
