"""`SPHFilter`: predict and update with state, in the shape filterpy users know."""

import numpy as np

from .adapt import Prediction, Update, fewest, predict_adapting, predict_relaying, update_repeating
from .checkpoint import origin_from, stored_origin
from .config import FilterConfig, checked_filter_config
from .density import ParticleDensity
from .errors import ModelError
from .initial import Gaussian, initialize
from .models import SDE
from .predict import predict
from .readings import checked_sensor, read, sensor_of
from .results import run_filter
from .storage import density_from, load_arrays, part, stored, under, write_arrays
from .validate import array, count, covariance, positive, real, row, short

__all__ = ["SPHFilter"]

#: What a file holds besides the density and where it comes from.
_MOMENTS = "x_prior", "P_prior", "x_post", "P_post"
_STATE = ("n_particles", "dt", "z", "y", "S", "log_likelihood", "log_evidence", *_MOMENTS)
_FIXED = (
    "the {} of a density filter cannot be overwritten (IMM mixing does that); "
    "make a new SPHFilter with x0 and P0"
)


class SPHFilter:
    """A Bayes filter that carries the probability density on SPH particles (002).

    Parameters
    ----------
    model : SDE
    measurement : GaussianMeasurement, LikelihoodMeasurement or None
        The sensor `update` uses unless another is given.
    x0 : array_like, shape (n,)
        Initial mean.
    P0 : array_like, shape (n, n)
        Initial covariance, positive definite.
    t0 : float
        Time of the initial density, seconds.
    n_particles : int or "auto"
        Upper bound of the number of particles at every re-gridding. "auto" lets it follow the error that the
        log-density scheme sees in itself towards the configuration's `target_error`.
    config : FilterConfig, optional
    density : ParticleDensity, optional
        Initial density instead of x0, P0 and t0.
    dt : float, optional
        Makes ``predict()`` advance by dt seconds when called without argument, as in filterpy.

    Attributes
    ----------
    x, P : ndarray, shape (n,) and (n, n)
        Mean and covariance now; `x_prior`, `P_prior` before and `x_post`, `P_post` after the last update.
    t : float
    density : ParticleDensity
    z, y, S : ndarray or None
        Last measurement, its innovation and innovation covariance, NaN where no reading came; None before
        the first, and y and S for sensors that are no `GaussianMeasurement`.
    log_likelihood : float
        Log-evidence of the last measurement, given all before; zero where none came.
    log_evidence : float
        Sum of the above.

    Notes
    -----
    A predict or update that raises leaves the filter as it was. The filter draws no random numbers: the
    same input gives the same bits.

    Of filterpy's filters it has ``predict()``, ``update(z)``, ``update(None)``, ``update(z, R, H)``; x, P,
    their priors and posteriors, z, y, S, log_likelihood and likelihood, to be read; and it works in ``Saver``
    and ``MMAEFilterBank``. It has no F, Q, K or H to be set, no ``update(z, HJacobian, Hx)``, and no place in
    ``IMMEstimator``, which overwrites x and P.
    """

    def __init__(
        self,
        model,
        measurement,
        x0=None,
        P0=None,
        *,
        t0=0.0,
        n_particles=200,
        config=None,
        density=None,
        dt=None,
    ):
        if not isinstance(model, SDE):
            raise ModelError(f"model must be an SDE or LinearSDE, got {short(model)}")
        self.model = model
        self.measurement = None if measurement is None else checked_sensor(measurement, model)
        self.config = checked_filter_config(config)
        self._adapts = isinstance(n_particles, str)
        given = fewest(model.dim, n_particles) if self._adapts else n_particles
        self.n_particles = count("n_particles", given)
        self.dt = None if dt is None else positive("dt", dt)
        self._density = self._start(x0, P0, t0, density)
        self._origin = None  # the Prediction or Update that the density comes from
        self._moments()
        self.x_prior, self.P_prior = self.x_post, self.P_post = self._x, self._P
        self.z = self.y = self.S = None
        self.log_likelihood = self.log_evidence = 0.0

    def _start(self, x0, P0, t0, density):
        if density is not None:
            if x0 is not None or P0 is not None:
                raise ModelError("give either x0 and P0, or density=, not both")
            if not isinstance(density, ParticleDensity) or density.dim != self.model.dim:
                raise ModelError(f"density must be a ParticleDensity of {self.model.dim} states")
            return density
        if x0 is None or P0 is None:
            raise ModelError("the filter needs x0 and P0, or density=")
        n = self.model.dim
        x0 = array("x0", x0, (n,), f"a value for each of the model's {n} states")
        P0 = covariance("P0", P0, dim=self.model.dim)
        return initialize(Gaussian(x0, P0), self.n_particles, self.config, t=real("t0", t0))

    def _moments(self):
        self._x, self._P = self._density.mean(), self._density.cov()
        self._x.flags.writeable = self._P.flags.writeable = False  # else flt.x += d would half succeed

    def __repr__(self):
        scheme = self.config.scheme
        return (
            f"SPHFilter(states={self.model.states}, t={self.t:g}, x={row(self._x)}, "
            f"std={row(np.sqrt(np.diag(self._P)))}, {self._density.n_particles} particles "
            f"(at most {self.n_particles}), scheme={scheme if isinstance(scheme, str) else scheme.name!r})"
        )

    density = property(lambda self: self._density, doc="The density now.")
    adapts = property(lambda self: self._adapts, doc='Made with ``n_particles="auto"``.')
    t = property(lambda self: self._density.t, doc="Time of the density, seconds.")
    likelihood = property(
        lambda self: float(np.exp(self.log_likelihood)), doc="Evidence of the last measurement."
    )

    @property
    def x(self):
        """Mean, shape (n,)."""
        return self._x

    @x.setter
    def x(self, value):
        raise ModelError(_FIXED.format("mean"))

    @property
    def P(self):
        """Covariance, shape (n, n)."""
        return self._P

    @P.setter
    def P(self, value):
        raise ModelError(_FIXED.format("covariance"))

    def predict(self, dt=None, *, t=None):
        """Advance by dt seconds, or to time t; without either by the filter's own dt. Returns PredictInfo.

        filterpy's banks call ``predict(0)``, for no control: a filter with a dt of its own advances by it.
        """
        if t is None and (dt is None or (self.dt is not None and np.ndim(dt) == 0 and dt == 0)):
            if self.dt is None:
                raise ModelError("predict needs dt or t=, or a filter made with dt=")
            dt = self.dt

        def predicted(density):
            options = {"t": t, "n_particles": self.n_particles}
            if self._adapts:
                return predict_adapting(density, self.model, dt, self.config, **options)
            return *predict(density, self.model, dt, self.config, **options), self.n_particles

        before, (density, info, n_particles) = predict_relaying(
            predicted, self.model, self._density, self._origin, self.config, self.n_particles
        )
        self._density, self.n_particles = density, n_particles
        self._origin = Prediction(before, info.mass_error, self.model, density.t)
        self._moments()
        self.x_prior, self.P_prior = self._x, self._P
        return info

    def update(self, z, measurement=None, H=None):
        """Use a measurement z, of another sensor if given; None or NaN is missing. Returns UpdateInfo.

        As in filterpy, a number or matrix in the place of the sensor is the noise covariance R of this
        reading, and H its matrix or function h; the rest stays that of the filter's own sensor.
        """
        measurement = sensor_of(self.measurement, measurement, H, self.model)
        prediction = self._origin if isinstance(self._origin, Prediction) else Prediction()
        prior, density, info = update_repeating(
            prediction, self._density, self.model, measurement, z, self.config, self.n_particles
        )
        if prior is not self._density:
            self._density = prior
            self._moments()
        self.x_prior, self.P_prior = self._x, self._P
        self._density = density
        self._origin = Update(prior, measurement, z) if density is not prior else None
        self._moments()
        self.x_post, self.P_post = self._x, self._P
        self.z, self.y, self.S = read(measurement, z, info)
        self.log_likelihood = info.log_evidence
        self.log_evidence += info.log_evidence
        return info

    def save(self, path):
        """Write the filter as it stands to an npz file; model and sensor, which are code, are not in it."""
        state = {name: getattr(self, name) for name in _STATE if getattr(self, name) is not None}
        arrays = {name: np.asarray(value) for name, value in state.items()} | {
            "config": np.array(self.config.to_toml()),
            "adapts": np.array(self._adapts),
        }
        arrays |= under("density", stored(self._density))
        write_arrays(path, arrays | under("origin", stored_origin(self._origin, self.measurement)))

    @classmethod
    def load(cls, path, model, measurement):
        """Read a filter that `save` wrote, with the model and sensor it had: it goes on to the same bits.

        Raises
        ------
        ModelError
            The file cannot be read or holds no filter, or the model has other states.
        """
        arrays = load_arrays(path)
        if "adapts" not in arrays:
            raise ModelError(f"{path} holds no filter: SPHFilter.save writes such files")
        filt = cls(
            model,
            measurement,
            density=density_from(part("density", arrays)),
            n_particles=int(arrays["n_particles"]),
            config=FilterConfig.from_toml(str(arrays["config"])),
        )
        for name in _STATE:
            value = arrays.get(name)
            setattr(filt, name, value.item() if value is not None and value.ndim == 0 else value)
        for name in _MOMENTS:
            getattr(filt, name).flags.writeable = False
        filt._adapts = bool(arrays["adapts"])
        filt._origin = origin_from(part("origin", arrays), model, filt.measurement)
        return filt

    def run(self, times, measurements):
        """Predict to each time and update with its measurement; returns a `FilterResult`."""
        return run_filter(self, times, measurements)
