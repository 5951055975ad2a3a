"""Tests compile into a cache of their own."""

import os
import tempfile
from pathlib import Path

import pytest

_user = getattr(os, "getuid", int)()  # zero where there are no such numbers
_folder = Path(tempfile.gettempdir()) / f"sphfilter-test-cache-{_user}"
os.environ.setdefault("NUMBA_CACHE_DIR", str(_folder))
os.environ.setdefault("NUMBA_NUM_THREADS", "2")
os.environ.setdefault("MPLBACKEND", "Agg")
# The matrices are small: threads only wait for each other, the longer the busier the machine is.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

_TESTS = Path(__file__).parent
_SHORT = {"first_filter"}  # notebooks that run by default: each is a process that compiles anew
#: Marks of all tests in a folder; what compiles are tests that carry densities, of many models.
MARKS = {
    "adapters": ["compiles", "stonesoup"],
    "campaign": ["compiles"],
    "command": ["compiles"],
    "consistency": ["quick"],
    "core": ["quick"],
    "density": ["compiles"],
    "experiments": ["compiles", "experiments"],
    "family": ["compiles"],
    "filter": ["compiles"],
    "inference": ["compiles"],
    "lattice": ["quick"],
    "model": [],
    "package": [],
    "pieces": ["compiles"],
    "prediction": ["compiles"],
    "reference_filters": [],
    "regression": ["compiles"],
}
#: Files of other folders that are quick too: with the folders above under two minutes of one core, warm.
QUICK = {
    "model/test_asking.py",
    "model/test_expressions.py",
    "model/test_inputs_and_tables.py",
    "model/test_measurements.py",
    "package/test_config.py",
    "package/test_house.py",
    "package/test_markers.py",
    "package/test_readme.py",
    "package/test_root_files.py",
}


#: Tests of six seconds and more, beside which shorter ones find most of what they find: slow.
LONG = {
    "adapters/test_stonesoup_association.py::test_association_is_the_mixture_on_one_lattice[0.98-0.002]",
    "adapters/test_stonesoup_tracker.py::test_nearest_neighbour_is_as_good_as_a_particle_filter_on_the_same_detections",
    "adapters/test_stonesoup_tracker.py::test_single_target_tracker_with_pda_is_exact_bayes[20-10000-0.05]",
    "campaign/test_campaign_dask.py::test_dask_gives_the_same_bits_and_keeps_runs",
    "campaign/test_interrupt.py::test_an_interrupt_ends_all_and_keeps_what_is_finished[1]",
    "campaign/test_interrupt.py::test_an_interrupt_that_python_drops_ends_a_campaign_all_the_same",
    "campaign/test_verdict.py::test_right_filters_are_faulted_one_time_in_a_hundred_at_most",
    "core/test_compiling.py::test_where_nothing_can_be_written_to_code_is_kept_in_a_temporary_folder",
    "core/test_jit.py::test_names_in_the_cache_change_with_any_file_of_the_references",
    "core/test_linking.py::test_a_function_is_linked_until_python_calls_it_also_from_the_cache",
    "core/test_linking.py::test_the_import_leaves_alone_what_others_compile",
    "core/test_noise_paths.py::test_blocks_of_states_have_the_same_bits",
    "density/test_local_kernels.py::test_density_and_its_error_against_grids",
    "density/test_statistics.py::test_entropy_of_a_gaussian[mixture]",
    "experiments/test_experiments_campaign.py::test_page_stands_alone_and_markdown_shows_its_pictures",
    "experiments/test_experiments_converge.py::test_more_nodes_are_no_worse[arguments0-sensors-1e-05]",
    "experiments/test_experiments_scaling.py::test_table_and_file",
    "experiments/test_own_system.py::test_a_probe_of_three_states_is_written_but_not_drawn",
    "experiments/test_own_system.py::test_a_slice_and_a_line_are_drawn_too",
    "experiments/test_own_system.py::test_the_example_of_the_help_runs_as_printed",
    "experiments/test_scenario_inputs.py::test_a_campaign_writes_a_scenario_that_runs_again",
    "experiments/test_stress.py::test_a_tail_that_the_next_reading_asks_for_is_not_lost",
    "experiments/test_stress.py::test_cases_have_unique_names_and_the_same_bits_each_time",
    "experiments/test_stress.py::test_clouds_know_their_own_error",
    "experiments/test_stress.py::test_command_writes_its_files_and_resumes[options1-stress-Kalman filter-2]",
    "experiments/test_stress.py::test_default_filter_is_right_on_hard_cases_or_refuses[noise_on_some_rows/integrators/3]",
    "experiments/test_stress.py::test_default_filter_is_right_on_hard_cases_or_refuses[units/time_Van_der_Pol/1e+06]",
    "experiments/test_stress.py::test_random_problems_are_right_or_flagged[10]",
    "experiments/test_stress.py::test_random_problems_are_right_or_flagged[12]",
    "experiments/test_stress.py::test_random_problems_are_right_or_flagged[14]",
    "experiments/test_stress.py::test_random_problems_are_right_or_flagged[15]",
    "experiments/test_stress.py::test_random_problems_are_right_or_flagged[28]",
    "experiments/test_stress.py::test_random_problems_are_right_or_flagged[2]",
    "experiments/test_stress.py::test_random_problems_are_right_or_flagged[5]",
    "experiments/test_stress.py::test_the_judge_tells_right_from_wrong[GridFilter-right]",
    "experiments/test_stress.py::test_the_judge_tells_right_from_wrong[PriorFilter-wrong, silent]",
    "filter/test_budget.py::test_modes_have_as_many_points_as_fit",
    "filter/test_discrete_filter.py::test_smoothing_is_that_of_a_grid_and_of_kalmans_matrices",
    "filter/test_discrete_filter.py::test_stochastic_volatility_and_the_fit_of_its_memory",
    "filter/test_discrete_filter.py::test_the_growth_model_is_that_of_a_grid_its_far_modes_included[0]",
    "filter/test_filter.py::test_benes_filter[paper]",
    "filter/test_jump_markov_filter.py::test_mode_probabilities_of_a_whole_record_are_those_of_the_grid[nonlinear]",
    "filter/test_ladder.py::test_a_reading_is_made_again_as_long_as_that_takes_no_more_than_a_try_may[268435456]",
    "filter/test_ladder.py::test_a_tail_that_a_family_got_wrong_and_a_reading_asks_for_is_predicted_again[0.02]",
    "filter/test_ladder.py::test_records_are_smoothed_on_lattices",
    "filter/test_many_states.py::test_a_linear_chain_is_kalmans_filter_and_its_points_are_near[10]",
    "filter/test_many_states.py::test_a_linear_chain_is_kalmans_filter_and_its_points_are_near[12]",
    "filter/test_many_states.py::test_two_chains_of_five_are_ten_states",
    "filter/test_variance_errors.py::test_a_variance_that_heavy_tails_carry_is_right_or_flagged",
    "filter/test_variance_errors.py::test_variances_are_off_by_as_much_as_is_told[fitzhugh_nagumo]",
    "filter/test_walls.py::test_one_state[ou-1-60]",
    "inference/test_fitting.py::test_duffing_has_its_maximum_where_the_grid_has_it",
    "inference/test_model_comparison.py::test_errors_of_the_evidence_are_told",
    "inference/test_smoother.py::test_what_no_lattice_follows_goes_on_as_clouds",
    "inference/test_smoother_changes_in_time.py::test_in_one_go_or_in_two[2-at a reading]",
    "inference/test_smoother_changes_in_time.py::test_in_one_go_or_in_two[2-drift]",
    "inference/test_smoother_changes_in_time.py::test_in_one_go_or_in_two[2-events]",
    "inference/test_smoother_changes_in_time.py::test_in_one_go_or_in_two[2-noise]",
    "inference/test_smoother_noise_of_the_state.py::test_one_state[geometric]",
    "inference/test_smoother_noise_of_the_state.py::test_two_states[two noises]",
    "lattice/test_spacing.py::test_a_lattice_moves_with_both_schemes_that_take_it",
    "model/test_jump_markov.py::test_paths_have_the_moments_of_the_model",
    "model/test_jump_markov.py::test_times_in_a_mode_are_exponential_and_jumps_go_where_the_rates_say",
    "model/test_models.py::test_stratonovich_term_and_divergence_of_diffusion",
    "model/test_noise_of_sensors.py::test_parameters_of_a_sensor_are_fitted",
    "model/test_simulate.py::test_weak_order_for_additive_noise",
    "package/test_docstrings.py::test_examples[compile]",
    "package/test_properties.py::test_linear_gaussian_problems_are_solved_or_refused",
    "package/test_properties.py::test_mildly_nonlinear_problems_are_solved_or_refused",
    "package/test_properties.py::test_order_of_the_states_does_not_matter",
    "package/test_recipes.py::test_a_recipe[Unknown parameters 2]",
    "prediction/test_cloud.py::test_two_wells_as_on_a_fine_lattice",
    "prediction/test_faulty_functions.py::test_exceptions_in_threads_do_not_end_python",
    "prediction/test_noise_of_the_state.py::test_one_equation_written_in_other_ways[function]",
    "prediction/test_noise_of_the_state.py::test_one_equation_written_in_other_ways[rows]",
    "reference_filters/test_reference_inlined.py::test_a_drift_in_python_goes_the_general_way",
    "reference_filters/test_reference_inlined.py::test_a_drift_in_text_and_as_a_function_move_alike",
    "reference_filters/test_reference_inlined.py::test_noises_of_any_densities_move_the_states_they_belong_to[Q1]",
    "reference_filters/test_reference_inlined.py::test_weak_order_against_the_exact_transition[2-1.6-2.6]",
    "reference_filters/test_reference_monte_carlo.py::test_intervals_hold_the_exact_value_as_often_as_they_say",
    "reference_filters/test_reference_monte_carlo.py::test_noise_that_depends_on_state_and_time",
    "reference_filters/test_reference_normals.py::test_they_are_normal",
}


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    for item in items:
        if (item.path.suffix == ".ipynb" and item.path.stem not in _SHORT) or is_long(item):
            item.add_marker("slow")
        for mark in marks_of(item):
            item.add_marker(mark)


def is_long(item):
    """Whether a test is in the list of long ones."""
    inside = item.path.is_relative_to(_TESTS)
    return inside and f"{item.path.relative_to(_TESTS).as_posix()}::{item.name}" in LONG


def marks_of(item):
    """Marks that a test has by where it stands; what is slow is never quick."""
    if not item.path.is_relative_to(_TESTS):
        return ["compiles"]  # notebooks
    place = item.path.relative_to(_TESTS)
    marks = {*MARKS[place.parts[0]], *(["quick"] if place.as_posix() in QUICK else [])}
    return sorted(marks - {"quick"} if item.get_closest_marker("slow") else marks)


@pytest.fixture
def ctrl_c_after(monkeypatch):
    """Make Ctrl-C come in `propagate` once it has passed a time; returns `propagate` as it was."""
    import sphfilter as sf  # not before the lines above

    propagate = sf.propagate

    def stop(after):
        def stopped(density, model, times, config, callback, **options):
            def until(density, info):
                if density.t > after:
                    raise KeyboardInterrupt
                callback(density, info)

            return propagate(density, model, times, config, callback=until, **options)

        monkeypatch.setattr(sf, "propagate", stopped)
        return propagate

    return stop
