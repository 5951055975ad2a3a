"""Fit parameters of a model file: the fit as JSON, and the file with the fitted values."""

from argparse import ArgumentParser, Namespace
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tomli_w

from ..errors import ConfigError, nearest
from ..files.model_file import with_tables
from ..files.read_model import ModelOfFile, read_model
from ..files.write import write_json
from ..inference.estimation import ParameterFit, fit_parameters
from ..settings import read_toml
from . import pictures
from .options import add_files, bound, by_name, number, place
from .progress import Say


def add_arguments(parser: ArgumentParser) -> None:
    """Add the options of ``fit``."""
    add_files(parser)
    parser.add_argument("--parameters", required=True, help="names, such as a,b; others stay as they are")
    parser.add_argument("--guess", default="", help="where to begin, a=0.5,b=1 (default: the file's values)")
    parser.add_argument("--bounds", default="", help="lowest and highest values, such as a=0:2,b=0:")


@dataclass
class _Best:
    """The best of the runs so far."""

    say: Say
    estimate: dict[str, float] = field(default_factory=dict)
    log_evidence: float = float("-inf")
    runs: int = 0

    def __call__(self, runs: int, parameters: dict[str, float], log_evidence: float) -> None:
        """Take a run into account, and tell of it."""
        self.runs = runs
        if log_evidence > self.log_evidence:
            self.estimate, self.log_evidence = dict(parameters), log_evidence
        shown = ", ".join(f"{name} = {value:.4g}" for name, value in parameters.items())
        self.say(f"run {runs}: log-evidence {log_evidence:.3f} at {shown}")


def main(args: Namespace, say: Say) -> str:
    """Run the command, and return what it found; stopped, it writes the best parameters so far."""
    file = read_model(args.model)
    data, folder, best = file.read(args.data), place(args), _Best(say)
    guess = _guess(file, args.parameters.split(","), by_name("--guess", args.guess, number))
    bounds = by_name("--bounds", args.bounds, bound)
    try:
        fit = fit_parameters(
            file.filter(data),
            data.times,
            data.z,
            guess,
            bounds=bounds,
            report=best,
            inputs=data.inputs or None,
        )
    except KeyboardInterrupt:
        if not best.estimate:
            raise
        told = {"estimate": best.estimate, "log_evidence": best.log_evidence, "n_evaluations": best.runs}
        _write(folder, args.model, told | {"converged": False, "status": "stopped"})
        raise KeyboardInterrupt(f"stopped after {best.runs} runs; the best of them is in {folder}") from None
    _write(folder, args.model, _record(fit))
    free = [name for name in fit.names if name not in fit.at_bound]
    drawn: Any = {"fit.png": lambda: fit.plot(free[:6])} if free else {}  # as many as a picture has
    return f"{fit}\n{pictures.listed(folder, ['fit.json', 'fitted.toml'], drawn)}"


def _guess(file: ModelOfFile, names: list[str], given: dict[str, float]) -> dict[str, float]:
    """Where the search begins: what is given, else what the file says."""
    known = {**file.sensor.parameters, **file.model.parameters}
    for name in (*names, *given):
        if name not in known or name not in names:
            raise ConfigError(
                f"{name!r} is none of the parameters that are fitted{nearest(name, known)}; "
                f"{file.path} has {', '.join(known) or 'none'}, and --parameters names {', '.join(names)}"
            )
    return {name: float(known[name]) for name in names} | given


def _record(fit: ParameterFit) -> dict[str, Any]:
    names = ["log_evidence", "evidence_error", "aic", "bic", "n_readings", "n_evaluations"]
    names += ["converged", "status", "at_bound", "roughness", "data"]
    found = {"estimate": dict(fit.estimate), "standard_error": dict(fit.standard_error)}
    return found | {"covariance": fit.covariance.tolist()} | {name: getattr(fit, name) for name in names}


def _write(folder: Path, model: Path, record: dict[str, Any]) -> None:
    """Write a fit, and the model file with its values; numbers of tables stand in it."""
    write_json(folder / "fit.json", record)
    tree = _changed(with_tables(read_toml(model), model), record["estimate"])
    (folder / "fitted.toml").write_text(tomli_w.dumps(tree), encoding="utf-8")


def _changed(tree: dict[str, Any], values: Mapping[str, float]) -> dict[str, Any]:
    """A model file's tree with other values of parameters, which are where the file has them."""
    for place_of in (tree["model"], tree.get("sensor", {}), *tree.get("sensors", {}).values()):
        own = place_of.get("parameters", {})
        own.update({name: float(values[name]) for name in own if name in values})
    return tree
