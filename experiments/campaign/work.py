"""What `run` and `campaign` share: filters on a scenario, run many times and written."""

from dataclasses import asdict, dataclass
from pathlib import Path

from experiments.scene.filters import factories, name_of
from experiments.scene.scenario import Scenario
from experiments.show.files import write_toml
from experiments.terminal.running import run_shown, warm_up
from sphfilter.campaign.store import versions
from sphfilter.files.write import write_json


@dataclass(frozen=True)
class Work:
    """What is to be run."""

    scenario: Scenario
    filters: dict  # dict of str to Factory
    n_runs: int
    seed: int
    out: Path  # folder for results

    def prepare(self, console, folder):
        """Say what is going to be run, and compile."""
        settings = self.scenario.settings
        console.print(f"[bold]{self.scenario.name}[/]: {settings.description}")
        console.print(f"{settings.source}\n", style="dim")
        if len(list(folder.glob("run_*.npz"))) < self.n_runs:
            warm_up(console, self.scenario, self.filters)

    def run(self, console, n_jobs, folder):
        """Run all with a progress bar; finished runs are kept in `folder`."""
        return run_shown(console, self.scenario, self.filters, self.n_runs, self.seed, n_jobs, folder)

    def write(self, name, campaign, numbers, settings, **facts):
        """Write histories, the scenario as run, and NAME.json; returns what that holds."""
        self.out.mkdir(parents=True, exist_ok=True)
        campaign.save(self.out / "campaign.npz")
        write_toml(self.out / "scenario.toml", asdict(settings))
        record = {"scenario": self.scenario.name, "seed": campaign.seed, "filters": list(campaign.results)}
        record |= {"versions": versions(), "report": numbers.as_dict(), "settings": asdict(settings)}
        record |= {"failures": [failure._asdict() for failure in campaign.failures], **facts}
        write_json(self.out / f"{name}.json", record)
        return record


def work_of(args, scenario, names, n_runs, folder):
    """The `Work` that a command line asks for: filters by name (None: the scenario's), and where to."""
    seed = scenario.settings.runs.seed if args.seed is None else args.seed
    return Work(scenario, factories(names, scenario), n_runs, seed, args.out or folder)


def tell_failures(console, failures):
    """Print a line for each failure."""
    for run, name, message in failures:
        console.print(f"run {run}, {name_of(name)}: {message}", style="red")


def exit_code(numbers):
    """1 if a filter failed in every run, else 0."""
    return int(any(f.n_failed == f.n_runs for f in numbers.filters.values()))
