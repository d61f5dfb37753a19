"""`make test-changed`: which tests a change reaches."""

from tests.changed import tests_reached as reached


def test_a_change_reaches_its_own_tests_first_and_nothing_that_cannot_import_it() -> None:
    """Of the lock-in, tests of what imports it come before those farther away; a test of kernels is not among them."""
    files = reached(["daq/lock_in.py"])
    assert files.index("tests/daq/test_lock_in.py") < 5
    assert "tests/analysis/loop/test_verdict.py" in files
    assert not any(path.startswith("tests/kernels/") for path in files)


def test_an_effect_reaches_what_predicts_though_nothing_imports_it() -> None:
    """A file that is found by searching its folder reaches what imports the module that searches."""
    assert "tests/analysis/loop/test_close_loop.py" in reached(["model/effects/adhesion.py"])


def test_a_document_reaches_the_tests_of_documents() -> None:
    """A changed page runs what reads pages, and nothing else."""
    files = reached(["docs/how-to/runs.md"])
    assert "tests/docs/test_paths.py" in files
    assert all(path.startswith("tests/docs/") for path in files)
