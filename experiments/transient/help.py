"""What `transient --help` ends with: an example of a file, and the thesis' input file (000 5.2) beside it."""

__all__ = ["EPILOG", "EXAMPLE", "KEYS"]

EXAMPLE = """\
[model]                               # dX = drift dt + noise dW, with dW dW' = spectral_density dt
states = ["x", "v"]
units = ["m", "m/s"]
drift = ["v", "-c*v - k*x*(1 + b*x**2)"]
noise = [["0"], ["1"]]                # or, instead of noise and spectral_density, D itself:
spectral_density = [[1.0]]            # diffusion = [["0", "0"], ["0", "0.5"]]
parameters = { c = 0.4, k = 1.0, b = 0.1 }
# domain = ["unbounded", ["bounded", -9, 9]]       # or "periodic", or "reflecting"; "none" for no end

[start]                               # a density of the states at time = 0.0; zero outside the lattice
kind = "expression"                   # or "gaussian" with mean and cov, or "uniform"
pdf = "where(x**2 + v**2 < 1.44, exp(-(x**2 + v**2)/0.18), 0)"      # where it is zero lies no particle
lattice = { origin = [-1.2, -1.2], size = [2.4, 2.4], spacing = 0.1 }         # for "paper", "cloud"
# box = [[-1.2, 1.2], [-1.2, 1.2]]    # instead of a lattice: particles where the scheme wants them

[times]
end = 2.0
interval = 0.25                       # or, instead of both, at = [0.1, 0.5, 2.0]

[solver]
# n_particles = 500                   # at most; a lattice has its own number
# config.exact_linear = true          # closed form of what is linear and Gaussian
[solver.config.scheme]                # or config.scheme = "auto", "log_density" or "cloud"
name = "paper"
kernel = "gaussian"                   # or "cubic", "lucy", "wendland_c2", "wendland_c4"
support_range = [3.6, 3.6]            # smoothing length 1.2 spacings, times 3 for the Gaussian kernel
smoothing = "fixed_point"             # or "newton", "proportional", "fixed"
smoothing_iterations = 5
discard_unconverged = false
integrator = "midpoint"               # or "euler", "rk4"
cfl = "fixed"                         # or "relative" with c_cfl and dt_max, or "absolute" with c_cfl
dt_max = 0.005

[statistics]
moments = [[4, 0], [1, 3]]            # E[x^4], E[x v^3]; mean and second moments always
exceedance = ["abs(x) > 1", "x + t*v <= 0 and v > 0"]

[output]
every = 2                             # densities are kept, probed and filmed at every second time
csv = true                            # particles as CSV too

[probe]                               # what is looked at: --live, --animate, probe.png, probe/*.npz, *.csv
origin = [-3.0, -3.0]
size = [6.0, 6.0]                     # zero along a state that is held at its origin
spacing = 0.1
data = ["density", "smoothing_length", "density_gradient", "velocity"]     # or "log_density"
fps = 5

[reference]                           # "linear", "grid" or "monte_carlo"; or leave it out
kind = "monte_carlo"
n_paths = 20000
"""

#: The keys of 000's input file, section 5.2, and what they are here.
KEYS = (
    ("output.filename", "--out FOLDER"),
    ("output.csvExport", "output.csv; moments and probabilities are always in statistics.csv"),
    ("output.refreshRate", "times.interval (steps times dt, if they are fixed), output.every"),
    ("time.interval", "times.end, start.time being 0"),
    ("time.stepping [false, dt]", 'solver.config.scheme.cfl = "fixed", dt_max = dt'),
    ("time.stepping [true, S, dt]", 'cfl = "relative", c_cfl = S, dt_max = dt'),
    ("time.integration", "integrator"),
    ("particles.origin, size, spacing", "start.lattice; the spacing may be one for each state"),
    ("kernel.type", "kernel"),
    ("kernel.coupling eta", "support_range = [K eta, K eta], K = 3 gaussian, 2 cubic, 1 lucy"),
    ("kernel.maxNeighbors", "none: neighbour lists grow"),
    ("kernel.adaptiveSmoothing false", 'smoothing = "fixed"'),
    ("kernel.iterativeSolver", 'smoothing = "fixed_point" for FP, "newton" for NR'),
    ("kernel.iterationsMax", "smoothing_iterations"),
    ("kernel.discardNotConverged", "discard_unconverged"),
    ("kernel.initialCondition", 'start.kind = "expression", start.pdf'),
    ('kernel.initialCondition ""', 'start.kind = "uniform"'),
    ("domain.nDimensions", "none: as many as model.states"),
    ("domain.origin, size, type", 'model.domain, an axis a state; "infinite" is "unbounded"'),
    ("domain.cellScale", "none: cells follow the particles"),
    ("domain.maxParticlesPerCell", "none: cells grow"),
    ("statistics.moments", "statistics.moments"),
    ("statistics.exceedance", "statistics.exceedance"),
    ("probing.data", "probe.data"),
    ("probing.save", "--animate FILE.gif or .mp4; --live is the window"),
    ("probing.fps", "probe.fps"),
    ("probing.origin, size, spacing", "probe.origin, size, spacing"),
    ("dynamics.drift", "model.drift"),
    ("dynamics.diffusion", "model.diffusion: both are D, the half of g Q g'"),
    ("x0, x1, if(c, a, b), x^2", "names of model.states, where(c, a, b), x**2"),
)

_WIDTH = max(len(theirs) for theirs, _ in KEYS) + 2
_TABLE = "\n".join(f"  {theirs:{_WIDTH}}{ours}" for theirs, ours in KEYS)
_INDENTED = "\n".join(f"  {line}".rstrip() for line in EXAMPLE.splitlines())

EPILOG = f"""\
A file of your own, for --config my.toml; most of it may be left out. Text takes states, t, parameters,
numbers, pi, + - * / **, sin cos tan asin acos atan atan2 sinh cosh tanh exp log sqrt abs sign min max,
comparisons, and, or, and where(condition, a, b).

{_INDENTED}

Results are in results/transient/my, or --out; the file as it was understood, with all that it left open, is
transient.toml there. Scenarios of the project (`list`) have the same form.

From the input file of the thesis (000 5.2); scheme keys without a table belong to [solver.config.scheme]:

{_TABLE}
"""
