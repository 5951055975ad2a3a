"""What commands show with: numbers, tables, files, legends, and what an interruption says."""

import csv
import io
import json
import tomllib

import numpy as np
import pytest
from density_cases import whitened
from rich.console import Console

import sphfilter as sf
from experiments.show.comparison import least_eigenvalue, moment_errors
from experiments.show.files import whole, write_rows, write_toml
from experiments.show.particles import density_image
from experiments.show.style import legend_below, panels, plt
from experiments.show.tables import markdown, number, percent, print_table, table
from experiments.terminal.progress import Interrupted, bar, resumable
from sphfilter.files.write import write_csv, write_json


def shown(what):
    console = Console(file=io.StringIO(), width=60)
    console.print(what)
    return [line.rstrip() for line in console.file.getvalue().splitlines()]


def test_numbers_have_units_only_where_there_are_numbers():
    assert [number(v) for v in (np.pi, 1e-9, np.nan, -np.inf)] == ["3.14", "1e-09", "–", "–"]
    assert number(12.3, ".0f", " %") == "12 %"
    assert number(np.nan, ".0f", " %") == "–"
    assert number(np.nan, unknown="") == ""
    assert (percent(0.256), percent(np.nan)) == ("26%", "–")


def test_tables_for_the_terminal_and_for_markdown_stand_alike():
    rows = [("EKF", "1"), ("SPH", "22")]
    lines = shown(table("error [m]", ("who", "E[x]"), rows))
    assert "error [m]" in lines[0] and lines[2].split() == ["who", "E[x]"]  # brackets are no markup
    assert lines[4].endswith("  1") and lines[5].endswith(" 22")
    expected = ["| who | E[x] |", "| --- | ---: |", "| EKF | 1 |", "| SPH | 22 |"]
    assert markdown(("who", "E[x]"), rows) == expected
    assert markdown(("who", "E[x]"), [], left=2)[1] == "| --- | --- |"


def test_files_hold_what_was_written(tmp_path):
    write_csv(tmp_path / "new" / "a.csv", ["x", "name"], [(0.1, "a, b"), (None, "")])
    with open(tmp_path / "new" / "a.csv", newline="", encoding="utf-8") as file:
        assert list(csv.reader(file)) == [["x", "name"], ["0.1", "a, b"], ["", ""]]
    write_rows(tmp_path / "b.csv", [{"x": 1, "y": 2}, {"y": 4, "x": 3}])
    assert (tmp_path / "b.csv").read_text().split() == ["x,y", "1,2", "3,4"]
    write_json(tmp_path / "c.json", {"a": (1.5, float("nan")), "b": {"c": float("inf")}})
    assert json.loads((tmp_path / "c.json").read_text()) == {"a": [1.5, None], "b": {"c": None}}
    write_toml(tmp_path / "d.toml", {"a": None, "b": [{"c": None, "d": 1}], "e": (1, 2)})
    assert tomllib.loads((tmp_path / "d.toml").read_text()) == {"b": [{"d": 1}], "e": [1, 2]}


def test_a_file_appears_whole_or_not_at_all(tmp_path):
    path = tmp_path / "new" / "file"
    with pytest.raises(ValueError, match="no such luck"), whole(path) as file:
        file.write(b"half")
        raise ValueError("no such luck")
    assert not path.exists()
    with whole(path) as file:
        file.write(b"all")
        assert not path.exists()
    assert path.read_bytes() == b"all"


def test_a_legend_names_everything_once():
    figure, axes = panels(2, 2, (8, 4), 3)
    assert [ax.figure is figure for ax in axes.flat] == [True, True, True, False]
    for k, ax in enumerate(axes.flat[:3]):
        ax.plot([0, 1], label="same")
        ax.plot([1, 0], label=f"own {k}")
    texts = [text.get_text() for text in legend_below(figure, *axes.flat[:3]).get_texts()]
    plt.close(figure)
    assert texts == ["same", "own 0", "own 1", "own 2"]


def test_an_interruption_says_what_is_kept_and_other_errors_pass():
    with (
        pytest.raises(Interrupted, match=r"^Stopped; 3 of 4 are kept$"),
        resumable(lambda: "3 of 4 are kept"),
    ):
        raise KeyboardInterrupt
    with pytest.raises(RuntimeError, match="no such luck"), resumable(lambda: ""):
        raise RuntimeError("no such luck")


def test_a_bar_leaves_nothing_behind():
    console = Console(file=io.StringIO(), force_terminal=True, width=80)
    with bar(console, "runs", left=True) as move:
        move(1, 3, found=True)
        move(2, text="cells")
    assert "2/3" in console.file.getvalue() and "cells" in console.file.getvalue()


def test_moment_errors_are_those_of_whitened_moments_in_any_units():
    rng = np.random.default_rng(3)
    A = rng.standard_normal((2, 5, 3, 3))
    P, P_ref = A @ np.swapaxes(A, -1, -2) + np.eye(3)
    x, x_ref = rng.standard_normal((2, 5, 3))
    mean, cov = moment_errors(x, P, x_ref, P_ref)
    L = np.linalg.cholesky(P_ref)
    white = np.linalg.solve(L, (x - x_ref)[..., None])
    assert mean == pytest.approx(np.linalg.norm(white, axis=(1, 2)), rel=1e-10)
    assert cov == pytest.approx(np.linalg.norm(whitened(P, P_ref), axis=(1, 2)) / np.sqrt(3), rel=1e-10)
    units = np.array([1e-6, 1.0, 1e6])
    scaled = np.outer(units, units)
    again = moment_errors(x * units, P * scaled, x_ref * units, P_ref * scaled)
    assert np.array(again) == pytest.approx(np.array([mean, cov]), rel=1e-9)
    assert least_eigenvalue(P * scaled) == pytest.approx(least_eigenvalue(P), rel=1e-9)
    assert least_eigenvalue(np.empty((0, 2, 2))) == 1.0


@pytest.mark.parametrize("width", [20, 40, 80, 500])
def test_nothing_of_a_wide_table_is_cut(width):
    headings = ["when", *(f"quantity {k}" for k in range(30))]
    rows = [[f"{t} s", *(f"{100 * t + k}.12345" for k in range(30))] for t in (1, 2)]
    console = Console(file=io.StringIO(), width=width, color_system=None)
    print_table(console, table("", headings, rows))
    said = console.file.getvalue()
    assert "…" not in said and max(map(len, said.splitlines())) <= width
    for text in [*headings, *rows[0], *rows[1]]:
        assert text in said
    assert (said.count("when") == 1) == (width == 500)


def test_an_image_of_a_density_has_the_colours_of_its_particles():
    figure, ax = plt.subplots()
    normal = sf.Gaussian([1.0, -1.0], [[1.0, 0.5], [0.5, 2.0]])
    shade = density_image(ax, normal, [(-9.0, 11.0), (-11.0, 9.0)]).get_array()
    plt.close(figure)
    assert shade.max() == 0.0 and shade.min() >= -6.0
    row, column = np.unravel_index(np.argmax(shade), shade.shape)
    assert (column, row) == pytest.approx((149 * 10 / 20, 149 * 10 / 20), abs=1)
    assert np.ma.is_masked(shade[0, 0])  # nothing to be told
