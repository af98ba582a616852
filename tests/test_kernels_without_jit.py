"""The kernels as plain Python: the same tests, with Numba told to compile nothing."""

import os
import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).parent
CHOSEN = [
    "test_lattice.py",
    "test_coarsening.py::test_is_the_least_mesh_on_any_terrain",
    "test_coarsening.py::test_is_the_least_mesh_for_a_map_of_tolerances",
    "test_coarsening.py::test_threshold_is_the_papers_algorithm",
    "test_coarsening.py::test_removable_is_the_papers_matrix",
    "test_coarsening.py::test_levels_equal_separate_calls",
    "test_coarsening.py::test_flat_terrain_needs_two_triangles_and_noise_all_of_them",
    "test_budgets.py::test_is_the_finest_least_mesh_that_fits",
    "test_diagonals.py::test_is_the_twins_mesh_on_any_terrain",
    "test_diagonals.py::test_afterwards_chooses_the_smaller_squared_error",
    "test_diagonals.py::test_a_budget_gives_the_finest_mesh_of_real_looking_terrain",
    "test_squared_error.py::test_gains_are_differences_of_sums_of_squares",
    "test_squared_error.py::test_is_the_best_of_all_meshes_around_voids_and_what_is_kept",
    "test_squared_error.py::test_a_budget_gets_at_least_the_best_set_that_fits",
    "test_squared_error.py::test_of_equal_parts_as_many_are_kept_as_fit",
    "test_out_of_core.py::test_is_the_mesh_of_coarsen_on_any_terrain",
    "test_tiles.py::test_the_error_of_a_tile_is_what_its_samples_say",
    "test_tiles.py::test_a_tile_without_heights_passes_on_what_its_neighbours_keep",
    "test_criteria.py::test_eq_1_at_every_vertex",
    "test_criteria.py::test_measures_a_coarsened_mesh",
    "test_conformity.py::test_is_the_walks_of_the_paper",
    "test_adjacency.py::test_twins_run_the_other_way_along_the_same_edge",
    "test_adjacency.py::test_steps_around_a_triangle",
    "test_fitting.py::test_is_the_least_squares_solution",
    "test_fitting.py::test_the_tolerance_of_every_sample_is_kept",
    "test_refinement.py::test_is_the_papers_algorithm_step_after_step",
    "test_refine_to.py::test_bisection_from_two_triangles_is_the_least_mesh",
    "test_refine_to.py::test_keeps_the_promise_from_a_coarsened_mesh",
    "test_adaptive.py::test_makes_and_unmakes_the_triangles_that_the_docstrings_say",
    "test_adaptive.py::test_coarsening_all_again_and_again_comes_back_to_the_first_mesh",
    "test_adaptive.py::test_values_of_triangles_are_means_over_what_they_lie_in_or_hold",
    "test_distance.py::test_is_exact_near_and_far",
    "test_distance.py::test_is_the_nearest_of_all_triangles_of_any_grid",
    "test_distance.py::test_bounds_hold_what_samples_find",
    "test_hausdorff.py::test_of_a_plane_shifted_along_its_normal[0.5]",
    "test_hausdorff.py::test_of_a_lid_over_a_valley_is_where_both_sides_are_equally_far",
    "test_hausdorff.py::test_of_a_pyramid_and_its_base_is_its_height",
    "test_terrain_difference.py::test_is_the_sum_over_all_pairs_of_triangles",
    "test_sampling.py::test_takes_what_metro_takes",
    "test_quantized_mesh.py::test_neighbours_decode_their_common_vertices_to_equal_heights_and_normals",
    "test_quantized_mesh.py::test_every_rule_of_the_specification_holds",
    "test_tiles3d.py::test_skirts_hang_from_no_hole",
    "test_sampling.py::test_all_edges_get_points",
    "test_lod.py::test_keeps_what_the_twin_keeps_for_an_eye",
    "test_lod.py::test_keeps_what_the_twin_keeps_of_triangles_too_large_to_search_through",
    "test_lod.py::test_frames_keep_the_promise_too_while_they_morph",
    "test_lod.py::test_of_equals_all_or_none_are_kept",
    "test_lod.py::test_updates_equal_starting_afresh",
    "test_lattices.py::test_heights_are_bilinear_between_the_samples[UTM]",
    "test_lattices.py::test_an_l_of_rasters_has_no_hole_at_its_inner_corner",
]
# Notes every kernel that runs, so that one left out of the tests above is found.
PROGRAM = """
import inspect, pkgutil, sys
from importlib import import_module
import numba, pytest, rtin._kernels

names = [f"rtin._kernels.{module.name}" for module in pkgutil.iter_modules(rtin._kernels.__path__)]
names.remove("rtin._kernels._jit")
kernels = {
    function.__code__: f"{name}.{function.__name__}"
    for name in names
    for _, function in inspect.getmembers(import_module(name), inspect.isfunction)
    if function.__module__ == name
}
assert numba.config.DISABLE_JIT and len(kernels) > 20

def note(frame, event, argument):
    if event == "call":
        kernels.pop(frame.f_code, None)

sys.setprofile(note)
status = pytest.main(["-q", "-x", "-p", "no:cacheprovider", "-n0", *sys.argv[1:]])
sys.setprofile(None)
print("kernels that never ran:", sorted(kernels.values()))
sys.exit(status or bool(kernels))
"""


def test_every_kernel_gives_the_same_as_plain_python():
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, *(str(TESTS / chosen) for chosen in CHOSEN)],
        cwd=TESTS.parent,
        env={**os.environ, "NUMBA_DISABLE_JIT": "1", "RTIN_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-5000:] + done.stderr[-2000:]
