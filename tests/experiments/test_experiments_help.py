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
    assert "Try first:  python -m experiments run duffing" in text
    for name in commands.COMMANDS:
        assert re.search(rf"^  {name} ", text, re.MULTILINE), name
    assert max(map(len, text.splitlines())) <= 104


def test_every_example_is_a_command(capsys):
    examples = lines(shown(capsys=capsys))
    assert len(examples) >= 2 * 10
    for line in examples:
        if "--help" not in line:
            assert commands.parser(line).parse_args(line).main is commands.module(line[0]).main


@pytest.mark.parametrize("name", commands.COMMANDS)
def test_the_help_of_a_command_has_examples_of_it(name, capsys):
    examples = lines(shown(name, capsys=capsys))
    assert len(examples) >= 2
    assert all(line[0] == name for line in examples)


def test_measured_data_have_an_example(capsys):
    assert "python -m experiments run sunspots" in shown("run", "sunspots", capsys=capsys)


def test_a_command_that_no_group_has_comes_last():
    summaries = dict.fromkeys(commands.COMMANDS, "words") | {"brandnew": "what is new"}
    assert re.search(r"More\n(  .*\n)*  brandnew +what is new", guide.overview(summaries))
    assert guide.examples("brandnew") == ""


def test_a_wrong_word_is_answered_before_the_library_is_imported():
    code = "import sys\nfrom experiments.__main__ import main\ntry:\n    main(['nosuch'])\nfinally:\n"
    code += "    assert 'numba' not in sys.modules and 'sphfilter' not in sys.modules"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2 and "invalid choice: 'nosuch'" in done.stderr
    assert "AssertionError" not in done.stderr
