"""What the default filter does and tells on ten small scenes, kept beside this file to be held against.

    python tests/regression/told.py           # run the scenes, and print what is not as it was
    python tests/regression/told.py --write   # ... and write told.json anew: commit it, say why it changed

By reading: what stood for the density after prediction and reading, evaluations of the drift, points, and the
error told. Clocks are not in it.
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np

FILE = Path(__file__).with_suffix(".json")
SEED, READINGS = 1, 10
#: Every rung in one to six states: lattices; clouds; families and what follows them where they fail.
SCENES = (
    "double_well",
    "van_der_pol",
    "duffing",
    "fitzhugh_nagumo",
    "pendulum",
    "predator_prey",
    "falling_body",
    "vehicle",
    "tracking",
    "three_oscillators",
)
#: Readings of a record that another representation may carry. On one machine there is none; on another the
#: last bit of a sum differs, which may tip a choice that hangs by a hair, and does so for a reading or two.
OTHER_RUNGS = 2
#: Geometric mean over a record up to which counts and errors may have changed, 2^(2 / 10): points go in
#: steps of two, and so much is left where two readings of ten take the next step.
RATIO = 2.0 ** (OTHER_RUNGS / READINGS)


def told(name):
    """Columns of what the filter tells of a scene, a value a reading."""
    from experiments.scene.filters import factories
    from experiments.scene.scenario import load_scenario

    scenario = load_scenario(name)
    case = scenario.draw(np.random.default_rng(SEED))
    flt = factories(["sph"], scenario)["sph"](case, np.random.default_rng(SEED))
    steps = []
    for t, z in zip(case.times[:READINGS], case.z[:READINGS], strict=True):
        steps.append((flt.predict(t=t), flt.update(z)))
    return {
        "rung": [f"{predicted.rung}, {updated.rung}" for predicted, updated in steps],
        "evaluations": [predicted.n_evaluations for predicted, _ in steps],
        "points": [updated.n_particles for _, updated in steps],
        "error": [float(f"{updated.error:.4g}") for _, updated in steps],
    }


def differences(before, now):
    """Sentences on what is not as it was, beyond what another machine may change."""
    pairs = list(zip(before["rung"], now["rung"], strict=True))
    same = [one == other for one, other in pairs]
    if same.count(False) > OTHER_RUNGS:
        others = [f"{one} -> {other}" for one, other in pairs if one != other]
        yield f"{len(others)} readings are carried by another representation: {'; '.join(others)}"
    for what in ("evaluations", "points", "error"):
        ratio = mean_ratio(np.array(before[what])[same], np.array(now[what])[same], float(what != "error"))
        if not 1.0 / RATIO <= ratio <= RATIO:
            yield f"{what}: {ratio:.3g} times what there was"


def mean_ratio(before, now, least):
    """Geometric mean of now / before; `least` is added to both, for counts that are zero."""
    return float(np.exp(np.mean(np.log((now + least) / (before + least))))) if before.size else 1.0


def main():
    """Run, compare, and write if asked to; returns 1 where something is not as it was."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--write", action="store_true", help=f"write {FILE.name} anew")
    write = parser.parse_args().write
    sys.path.insert(0, str(FILE.parents[2]))
    before = json.loads(FILE.read_text(encoding="utf-8")) if FILE.exists() else {}
    now = {name: told(name) for name in SCENES}
    said = [
        f"{name}: {one}"
        for name in before.keys() & now.keys()
        for one in differences(before[name], now[name])
    ]
    print("\n".join(sorted(said)) or "all as it was")
    if write:
        FILE.write_text(as_text(now), encoding="utf-8")
    return int(bool(said) and not write)


def as_text(scenes):
    """JSON with a line a column."""
    blocks = []
    for name, columns in scenes.items():
        lines = ",\n".join(f"    {json.dumps(key)}: {json.dumps(value)}" for key, value in columns.items())
        blocks.append(f"  {json.dumps(name)}: {{\n{lines}\n  }}")
    return "{\n" + ",\n".join(blocks) + "\n}\n"


if __name__ == "__main__":
    sys.exit(main())
