"""The backend: candidates in order, a child's end survived and remembered, choices explained."""

import os
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from termwise.reference import backend, native
from termwise.reports.cli import terminal


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    """Give each test a cache of its own, and the variables as if the user had set none."""
    monkeypatch.setenv("TERMWISE_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("TERMWISE_BACKEND", raising=False)
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)


@pytest.fixture
def fetched(tmp_path, monkeypatch):
    """Folder to fill with the libraries that count as fetched."""
    monkeypatch.setattr(native, "fetched_folder", lambda: tmp_path / "native")
    folder = tmp_path / "native/usr/lib/x86_64-linux-gnu"
    folder.mkdir(parents=True)
    return folder


def interpreter_that(does: str, folder: Path) -> str:
    """Write a stand-in for the child's Python that runs shell commands, and return its path."""
    script = folder / "interpreter"
    script.write_text(f"#!/bin/sh\n{does}\n")
    script.chmod(0o755)
    return str(script)


@pytest.mark.parametrize(
    ("name", "version"),
    [
        ("libLLVM-15.so.1", (15,)),
        ("libLLVM-14.0.6.so.1", (14, 0, 6)),
        ("libLLVM.so.19.1", (19, 1)),
        ("libLLVM.so.20.1-rust", ()),
        ("libLLVM.dylib", ()),
    ],
)
def test_version_is_read_from_the_file_name(name, version):
    assert native.llvm_version(Path(name)) == version


def test_llvm_libraries_user_first_then_fetched_newest_first_and_each_once(fetched, tmp_path, monkeypatch):
    for name in ("libLLVM-9.so.1", "libLLVM.so.19.1", "libLLVMSupport.a"):
        (fetched / name).touch()
    (fetched / "libLLVM-19.so").symlink_to("libLLVM.so.19.1")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(tmp_path / "mine.so"))
    libraries = native.llvm_libraries()
    assert libraries[:3] == [tmp_path / "mine.so", fetched / "libLLVM.so.19.1", fetched / "libLLVM-9.so.1"]
    versions = [native.llvm_version(library) for library in libraries[3:]]
    assert versions == sorted(versions, reverse=True)
    assert len(set(libraries)) == len(libraries)


def test_preload_opens_dependencies_first_prefers_the_system_and_ends(fetched, monkeypatch):
    """Of a, which needs b, which needs c; one that never opens; and one that the system has as well."""
    needs = {"liba.so.1": "libb.so.1", "libb.so.1": "libc.so.1", "libc.so.1": None, "libbroken.so.1": "libnone.so"}
    for name in [*needs, "libsystem.so.6", "libLLVM.so.19.1"]:
        (fetched / name).touch()
    opened = []

    def loadable(library):
        if library == "libsystem.so.6" or (
            isinstance(library, Path) and needs[library.name] in [None, *(Path(done).name for done in opened)]
        ):
            opened.append(library)
            return True
        return False

    monkeypatch.setattr(native, "loadable", loadable)
    native.preload()
    paths = [fetched / name for name in ("libc.so.1", "libb.so.1", "liba.so.1")]
    assert [library for library in opened if isinstance(library, Path)] == paths
    assert "libsystem.so.6" in opened


@pytest.mark.parametrize(
    ("names", "package"),
    [
        ("libllvm14 libllvm19 libllvm-19-ocaml-dev libllvm20", "libllvm19"),
        ("libllvm18 libllvm21t64 libllvm22 libllvmspirvlib21", "libllvm21t64"),
    ],
)
def test_oldest_sufficient_llvm_is_fetched(names, package):
    assert native._llvm_package(names) == package


def test_no_sufficient_llvm_to_fetch_is_named():
    with pytest.raises(native.FetchError, match=f"libllvm{native.FETCHED_LLVM} or newer"):
        native._llvm_package("libllvm14 libllvm16")


def test_fetch_without_apt_is_named(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(native.FetchError, match="apt-get"):
        native.fetch(llvm=True)


def test_probe_renders_the_closed_form():
    assert backend.probe("scalar_rgb") == backend.PASSED


def test_probe_of_a_file_that_is_no_llvm_fails_in_one_line(tmp_path):
    library = tmp_path / "libLLVM.so.99"
    library.write_text("not a library")
    outcome = backend.probe("llvm_ad_rgb", library)
    assert outcome != backend.PASSED
    assert "LLVM" in outcome
    assert "\n" not in outcome


def test_llvm_that_cannot_compile_dr_jits_kernels_is_survived():
    """LLVM 15 and 16 end the process; kernels that a good LLVM left in Dr.Jit's cache must not hide it."""
    old = [library for library in native.llvm_libraries() if (0,) < native.llvm_version(library) < (17,)]
    if not old:
        pytest.skip("this machine has no LLVM older than 17 to fail with")
    assert backend.PASSED not in [backend.probe("llvm_ad_rgb", library) for library in old]


def test_abort_is_told_and_remembered_until_the_library_changes(tmp_path, monkeypatch):
    library = tmp_path / "libLLVM-15.so.1"
    library.touch()
    abort = interpreter_that('echo "LLVM ERROR: Cannot select: fminimum" >&2; kill -ABRT $$', tmp_path)
    monkeypatch.setattr(sys, "executable", abort)
    outcome = backend.probe("llvm_ad_rgb", library)
    assert outcome == "the process ended by SIGABRT. LLVM ERROR: Cannot select: fminimum"
    monkeypatch.setattr(sys, "executable", interpreter_that("exit 0", tmp_path))
    assert backend.probe("llvm_ad_rgb", library) == outcome
    os.utime(library, (1, 1))
    assert backend.probe("llvm_ad_rgb", library) == backend.PASSED


def test_failure_that_an_installation_may_mend_is_not_remembered(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "executable", interpreter_that("echo no driver >&2; exit 1", tmp_path))
    assert backend.probe("cuda_ad_rgb") == "no driver"
    monkeypatch.setattr(sys, "executable", interpreter_that("exit 0", tmp_path))
    assert backend.probe("cuda_ad_rgb") == backend.PASSED


@pytest.fixture
def two_llvms(monkeypatch):
    """Let the machine have an LLVM `bad` and then one `good`; return the list of those that work, to edit."""
    works = ["good"]
    monkeypatch.setattr(native, "lacks_libatomic", lambda: False)
    monkeypatch.setattr(native, "llvm_libraries", lambda: [Path("bad"), Path("good")])
    monkeypatch.setattr(backend, "probe", lambda variant, llvm=None: backend.PASSED if str(llvm) in works else "broke")
    return works


def test_first_llvm_that_passes_is_chosen(two_llvms):
    assert backend.choose()[:2] == ("llvm_ad_rgb", Path("good"))


def test_scalar_names_each_failure_and_what_to_install(two_llvms):
    two_llvms.clear()
    variant, llvm_path, reason = backend.choose()
    assert (variant, llvm_path) == ("scalar_rgb", None)
    assert all(part in reason for part in ("bad: broke", "good: broke", f"install libllvm{native.FETCHED_LLVM}"))


@pytest.mark.parametrize("variant", ["llvm_ad_rgb", "cuda_ad_rgb"])
def test_a_variant_asked_for_that_fails_is_an_error(two_llvms, variant):
    two_llvms.clear()
    with pytest.raises(backend.BackendError, match=f"{variant}: .*broke"):
        backend.choose(variant)


def test_variable_forces_the_variant_and_an_argument_goes_before_it(two_llvms, monkeypatch):
    monkeypatch.setenv("TERMWISE_BACKEND", "scalar_rgb")
    assert backend.choose().variant == "scalar_rgb"
    assert backend.choose("llvm_ad_rgb").variant == "llvm_ad_rgb"


def test_a_slow_variant_is_named_unless_it_was_asked_for(two_llvms, monkeypatch, capsys):
    """Of a command; and what it is asked for is what Mitsuba is loaded with, here and in its workers."""
    monkeypatch.setenv("TERMWISE_BACKEND", "")
    two_llvms.clear()
    with warnings.catch_warnings():
        assert terminal.choose_backend(None).variant == "scalar_rgb"
        said = " ".join(capsys.readouterr().err.split())
        assert said.startswith("termwise: references are rendered with scalar_rgb, which is slow: bad: broke")
        terminal.choose_backend(None, quiet=True)
        assert terminal.choose_backend("scalar_rgb").variant == "scalar_rgb"
    assert capsys.readouterr().err == ""
    two_llvms.append("good")
    assert backend.choose().variant == "scalar_rgb"
    assert terminal.choose_backend("llvm_ad_rgb").variant == "llvm_ad_rgb"
    assert backend.choose().variant == "llvm_ad_rgb"


def test_unknown_variant_is_named_with_what_is_allowed(monkeypatch):
    monkeypatch.setenv("TERMWISE_BACKEND", "llvm")
    with pytest.raises(ValueError, match="TERMWISE_BACKEND: 'llvm' is not one of cuda_ad_rgb, llvm_ad_rgb, scalar"):
        backend.choose()


def test_missing_libatomic_is_named(monkeypatch):
    monkeypatch.setattr(native, "lacks_libatomic", lambda: True)
    with pytest.raises(backend.BackendError, match="install libatomic1"):
        backend.choose("scalar_rgb")


def test_the_first_import_decides_for_the_process():
    """In a process of its own: this one keeps its variant for other tests."""
    code = (
        "from termwise.reference.backend import import_mitsuba, active\n"
        "print(import_mitsuba('scalar_rgb').variant(), import_mitsuba().variant(), active().variant)\n"
        "import_mitsuba('llvm_ad_rgb')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.split() == ["scalar_rgb"] * 3
    assert "this process already renders with scalar_rgb" in done.stderr


def test_neither_module_imports_mitsuba():
    code = "import sys, termwise.reference.backend; print({'mitsuba', 'drjit'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.strip() == "set()"
