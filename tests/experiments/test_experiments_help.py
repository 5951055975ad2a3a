"""The help of the commands: it names all, its examples are commands that can be given."""

import re
import shlex
import subprocess
import sys

import pytest

from experiments import commands, guide


def shown(*arguments, capsys):
    with pytest.raises(SystemExit) as stopped:
        commands.main([*arguments, "--help"])
    assert stopped.value.code == 0
    return capsys.readouterr().out


def lines(text):
    """What comes after "python -m experiments" in the examples, up to the comment."""
    found = re.findall(r"^ +python -m experiments (.+?)(?:  +#.*)?$", text, re.MULTILINE)
    return [shlex.split(line) for line in found]


def test_the_help_names_every_command_and_what_to_try_first(capsys):
    text = shown(capsys=capsys)
    assert "Try first:\n  python -m experiments run duffing" in text
    for name in commands.COMMANDS:
        assert re.search(rf"^  {name} ", text, re.MULTILINE), name
    assert max(map(len, text.splitlines())) <= 80


def test_every_example_is_a_command(capsys):
    examples = lines(shown(capsys=capsys))
    assert len(examples) >= 2 * 10
    for line in examples:
        if "--help" not in line:
            name, args = line[0], commands.parser(line).parse_args(line)
            assert args.command == name and callable(commands.module(name).main)
            if "my.toml" not in line:
                commands.asked(line)  # would raise what is wrong with it


@pytest.mark.parametrize("name", commands.COMMANDS)
def test_the_help_of_a_command_has_examples_of_it(name, capsys):
    examples = lines(shown(name, capsys=capsys))
    assert len(examples) >= 2
    assert all(line[0] == name for line in examples)


def test_a_command_that_no_group_has_comes_last():
    summaries = dict.fromkeys(commands.COMMANDS, "words") | {"brandnew": "what is new"}
    assert re.search(r"More\n(  .*\n)*  brandnew +what is new", guide.overview(summaries))
    assert guide.end_of_help("brandnew") == ""


def test_a_wrong_word_is_answered_before_the_library_is_imported():
    code = "import sys\nfrom experiments.__main__ import main\ntry:\n    main(['nosuch'])\nfinally:\n"
    code += "    assert 'numba' not in sys.modules and 'sphfilter' not in sys.modules"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2 and "invalid choice: 'nosuch'" in done.stderr
    assert "AssertionError" not in done.stderr


WRONG = {
    "run dufing": "no scenario 'dufing' (did you mean 'duffing'?)",
    "run duffing --set modell.x=3": "unknown key modell (did you mean 'model'?)",
    "run duffing --set times.end=soon": "times.end = 'soon'",
    "run duffing --filters ekf,shp": "no filter 'shp' (did you mean 'sph'?)",
    "run duffing --out {file}/results": "give another folder with --out",
    "campaign duffing --filters shp": "no filter 'shp'",
    "transient dufing": "no transient scenario 'dufing'",
    "transient duffing --set times.ende=3": "unknown key times.ende (did you mean 'end'?)",
    "sweep duffing --set modell.x=3": "unknown key modell",
    "converge duffing --counts 100": "two different counts at least are needed",
    "converge dufing": "no scenario 'dufing'",
    "estimate dufing": "no scenario 'dufing'",
    "filter --model {file} --data {file}": "is not valid TOML",
    "benchmark dufing": "no scenario 'dufing'",
    "benchmark --filters shp": "no competitor 'shp' (did you mean 'sph'?)",
    "stress --filters papr": "no filter 'papr' (did you mean 'paper'?)",
    "scaling --schemes papr": "no scheme 'papr'",
    "realtime dufing": "no scenario 'dufing'",
}


def test_what_is_wrong_is_said_in_one_line_before_anything_is_compiled(tmp_path):
    file = tmp_path / "file"
    file.write_text("no table")
    lines = [line.format(file=file).split() for line in WRONG]
    code = (
        f"import sys\nfrom experiments.__main__ import main\n"
        f"for line in {lines!r}:\n    assert main(line) == 1, line\n"
        "assert not {'numba', 'scipy', 'sympy', 'matplotlib', 'sphfilter'} & set(sys.modules)\n"
        "import sphfilter as sf\nassert sf.SPHFilter and sf.ConfigError"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    said = done.stderr.splitlines()
    assert done.returncode == 0 and len(said) == len(WRONG), done.stderr
    for sentence, expected in zip(said, WRONG.values(), strict=True):
        assert sentence.startswith("error: ") and expected in sentence
    assert sorted(tmp_path.iterdir()) == [file]


@pytest.mark.parametrize(
    ("line", "meant"),
    [
        ("rnu duffing", "'run'"),
        ("run duffing --rusn 3", "'--runs'"),
        ("campaign duffing --own-proir", "'--own-prior'"),
    ],
)
def test_what_may_have_been_meant_is_said_of_commands_and_options(line, meant, capsys):
    with pytest.raises(SystemExit) as stopped:
        commands.main(line.split())
    assert stopped.value.code == 2
    assert f"(did you mean {meant}?)" in capsys.readouterr().err


def test_without_a_command_the_help_is_shown(capsys):
    with pytest.raises(SystemExit) as stopped:
        commands.main([])
    assert stopped.value.code == 0
    assert "Try first:" in capsys.readouterr().out
