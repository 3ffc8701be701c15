"""The inner loop, `python -m pytest -m core`: which tests belong to it.

The first case of every test belongs to it, but only the first test of a slow file, which is its
main path, and nothing of the four files that take longest. `python tests/support/slow_files.py`
measures which files are slow.
"""

# Whole studies, clusters and every kind of executor; all printed answers.
LONG = frozenset("dask every_executor printed structures_over_flights".split())
# Files of tests whose first cases take 0.12 s of a processor on average, and more.
SLOW = frozenset(
    """
added_criteria algebraic_equations bad_inputs batch batch_command clocks columns compare
compare_command continued_runs dask determined_combinations disagreeing_record
discretization_error draws driver embedded_functions equivalent_minima every_executor examples
executors failed_runs failure few_samples fine_steering_mirror fit_command fitted_record
flattened_inputs frequency_correlation gain_comparison gusts hard_models held_estimate held_out
identify identify_command implicit_integrators injected_tests integration_error interrupted_batch
intersample irregular_samples kalman_gain kinetics kinks known_answers late_sensors laws
many_records margins margins_command measures misfit missing_terms nanobench nested_models nesting
nist not_finite orders other_minima outlying_points overview own_values page paper_study
pickled_fits pitch_moment predict_command printed process_noise process_noise_start profile
profile_command public_api published_cases random_vehicles ranking readme recipes
record_diagnostics record_group record_mistakes record_problems record_profile released_bounds
report report_command residuals response_command response_comparison response_solver robust_fit
safe_gains same_data sample saved_fits sensor_biases shared_errors shared_response shared_solver
simulate simulate_command sine_detection sitl_drag startup state_estimation state_starts
steep_bounds stepwise stiff_answers structural_identifiability structure_commands
structures_over_flights subprocess_reader substep_derivatives switching_parameters tables
the_paper threads time_criteria tiny_errors transcription transient_fits tune_command
uneven_clocks uneven_errors virtual_flight worker_pool wrapped_angles
""".split()
)


def core_tests(items):
    """Yield the tests of the inner loop, of all tests in their order."""
    functions, files = set(), set()
    for item in items:
        name = item.path.stem.removeprefix("test_")
        function = item.nodeid.partition("[")[0]
        is_first = item.path not in files if name in SLOW else function not in functions
        functions.add(function)
        files.add(item.path)
        if is_first and name not in LONG:
            yield item
