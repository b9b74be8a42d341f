"""Faults that are in no image: of keys, caches, the view and what is written. Each has the test that notices."""

from tests.audit.plants import PLANTS, Plant, Test

_CELLS = "tests/unit/test_cells.py::"
_VIEW = "tests/unit/test_view_state.py::"

UNSEEN = (
    # Keys: of equal ones the images are taken for one another.
    Plant(
        "key: the seed left out",
        Test(_CELLS + "test_the_name_follows_what_decides_the_bits"),
        "reports/jobs/cells.py",
        "        samples,\n        seed,\n        chain if",
        "        samples,\n        chain if",
    ),
    Plant(
        "key: the chain left out",
        Test(_CELLS + "test_the_name_follows_what_decides_the_bits"),
        "reports/jobs/cells.py",
        'chain if terms.TABLE[variant.term].meets else ""',
        '""',
    ),
    Plant(
        "key: the sources left out",
        Test(_CELLS + "test_the_name_follows_the_sources"),
        "renderer/terms/estimator.py",
        'return sources_digest(ROOT / "renderer", ROOT / "scenes")',
        'return "sources"',
    ),
    Plant(
        "key: roughness left out of the specular term",
        Test(_CELLS + "test_equal_names_mean_equal_bytes[roughness]"),
        "scenes/terms.py",
        'reads=(read(*_MATERIAL, "max_bounces"), read(',
        'reads=(read(*(each for each in _MATERIAL if "rough" not in each), "max_bounces"), read(',
    ),
    Plant(
        "key of a reference: the seed left out",
        Test("tests/oracle/test_reference_store.py::test_whatever_matters_changes_the_name"),
        "reference/store.py",
        "attrs.astuple(limit), spp, seed, by_second",
        "attrs.astuple(limit), spp, by_second",
    ),
    Plant(
        "key of kernels: callees of callees left out",
        Test("tests/unit/test_jit.py::test_digest_changes_with_what_a_module_reaches_and_nothing_else", compiled=True),
        "renderer/jit.py",
        "            waiting.extend(imported)",
        "            waiting.extend(imported if name == module and len(imported) < 2 else ())",
    ),
    Plant(
        "fingerprint: values that a function closes over left out",
        Test("tests/unit/test_fingerprint.py::test_equal_values_are_equal_and_others_are_not"),
        "renderer/fingerprint.py",
        "self.absorb(cell.cell_contents, variable)",
        "self._add(variable)",
    ),
    Plant(
        "keys of seeds overlap",
        Test("tests/kernels/test_rng.py::test_keys_of_all_streams_are_distinct"),
        "renderer/rng.py",
        "return stream(stream(np.uint64(0), seed), replicate)",
        "return stream(np.uint64(0), seed + replicate)",
    ),
    Plant(
        "a kept file is written where it will be read",
        Test(_CELLS + "test_an_interrupted_write_leaves_nothing"),
        "scenes/store.py",
        "        write(temporary)\n        temporary.replace(path)",
        "        write(path)",
    ),
    # The plan.
    Plant(
        "plan: a dented body taken for convex",
        Test("tests/kernels/test_skips.py::test_what_is_open"),
        "renderer/unoccluded.py",
        "return bool((heights.max(axis=1) <= allowed).all()), bool((heights.min(axis=1) >= -allowed).all())",
        "return True, bool((heights.min(axis=1) >= -allowed).all())",
    ),
    # The view.
    Plant(
        "view: samples of another seed shown",
        Test(_VIEW + "test_a_change_touches_what_depends_on_it"),
        "reports/live/state.py",
        "return term, name, self.seed, cells.content",
        "return term, name, cells.content",
    ),
    Plant(
        "view: the camera turns the other way",
        Test(_VIEW + "test_the_camera_goes_round_its_target"),
        "reports/live/state.py",
        "((sideways, -up), (axis, -right))",
        "((sideways, -up), (axis, right))",
    ),
    Plant(
        "view: a scaled lamp moves",
        Test(_VIEW + "test_the_light_of_a_lamp_is_moved_and_scaled"),
        "reports/live/state.py",
        "scaled = centre + (mesh.vertices - centre) * (extent / _extent(mesh))",
        "scaled = mesh.vertices * (extent / _extent(mesh))",
    ),
    Plant(
        "view: the command forgets the seed",
        Test(_VIEW + "test_the_command_names_what_differs"),
        "reports/live/state.py",
        '"--samples", str(samples), "--seed", str(state.seed)]',
        '"--samples", str(samples)]',
    ),
    Plant(
        "view: pages of any origin may speak to it",
        Test("tests/unit/test_view_guard.py::test_strangers_are_refused"),
        "reports/live/guard.py",
        "hosts[0] in self.hosts and ours.issuperset(origins)",
        "hosts[0] in self.hosts",
    ),
    # What is written.
    Plant(
        "saved scene: smooth normals lost",
        Test("tests/unit/test_scene_save.py::test_a_saved_scene_reads_back_as_itself"),
        "scenes/save.py",
        '    if thing.mesh.normals is not None:\n        table["normals"] = "smooth"\n',
        "",
    ),
    Plant(
        "OpenEXR: blue for red",
        Test("tests/unit/test_cli.py::test_judge_takes_folders_and_writes_a_page"),
        "reports/results/exr.py",
        "np.ascontiguousarray(image, np.float32)",
        "np.ascontiguousarray(image[..., ::-1], np.float32)",
    ),
    Plant(
        "table: a unit missing",
        Test("tests/unit/test_provenance.py::test_the_table_is_rfc_4180"),
        "reports/results/table.py",
        '("s, all replicates", "seconds"),',
        '(None, "seconds"),',
    ),
    Plant(
        "command of a row: the seed forgotten",
        Test("tests/unit/test_provenance.py::test_the_command_of_a_row"),
        "reports/results/provenance.py",
        '"--study", "--seed", "--budget"',
        '"--study", "--budget"',
    ),
    Plant(
        "exported script: constant factors forgotten",
        Test("tests/oracle/test_reference_export.py::test_exported_script_reproduces_the_bits"),
        "reference/export.py",
        'if render["factor"] != 1.0:',
        'if render["factor"] == 0.0:',
    ),
)
"""Beside those of images."""

ALL: tuple[Plant, ...] = (*PLANTS, *UNSEEN)
