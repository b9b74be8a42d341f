"""Which Mitsuba variant renders the references, and the one place that imports Mitsuba first.

`cuda_ad_rgb` on request; else `llvm_ad_rgb` with the first LLVM that passes a probe; else `scalar_rgb`.
Dr.Jit ends the whole process when LLVM cannot compile one of its kernels, so the probe renders a closed form
in a child process: a sphere of albedo 1 under a constant sky of radiance 1 has L_o = 1 in every pixel.
Its outcome is kept in the cache, named by all that it depends on. `python -m reference.backend` fetches the
native libraries that are missing and says what will render.
"""

import contextlib
import hashlib
import importlib
import os
import platform
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from termwise.reference import native
from termwise.scenes.store import ROOT, cache_folder, versions_of, write_atomically

VARIANTS = ("cuda_ad_rgb", "llvm_ad_rgb", "scalar_rgb")
PASSED = "passed"
_ASKED = "asked for"
_PROBE_SECONDS = 120


class BackendError(RuntimeError):
    """The variant asked for cannot render here; the message says why and what to install, in one line."""


class Backend(NamedTuple):
    """A Mitsuba variant, the LLVM that it compiles with (None: it uses none), and why it was chosen."""

    variant: str
    llvm_path: Path | None
    reason: str


def choose(requested: str | None = None) -> Backend:
    """Choose the variant: `requested`, else `$TERMWISE_BACKEND`, else LLVM where it works, else scalar.

    Raises
    ------
    ValueError : the name is none of `VARIANTS`.
    BackendError : the variant that was asked for failed its probe; or no variant can render, for want of libatomic.
    """
    source = "backend" if requested else "TERMWISE_BACKEND"
    requested = requested or os.environ.get("TERMWISE_BACKEND") or None
    if requested not in (None, *VARIANTS):
        raise ValueError(f"{source}: {requested!r} is not one of {', '.join(VARIANTS)}")
    native.preload()
    if native.lacks_libatomic():
        raise BackendError("Mitsuba needs libatomic.so.1 (install libatomic1, on some systems called libatomic)")
    if requested == "scalar_rgb":
        return Backend("scalar_rgb", None, _ASKED)
    if requested == "cuda_ad_rgb":
        outcome = probe("cuda_ad_rgb")
        if outcome != PASSED:
            raise BackendError(f"cuda_ad_rgb: {outcome}")
        return Backend("cuda_ad_rgb", None, _ASKED)
    failures = []
    for library in native.llvm_libraries():
        outcome = probe("llvm_ad_rgb", library)
        if outcome == PASSED:
            return Backend("llvm_ad_rgb", library, f"{library} passes the probe")
        failures.append(f"{library}: {outcome}")
    reason = "; ".join(failures or ["no LLVM library was found"])
    reason += f" (install libllvm{native.FETCHED_LLVM} or newer, or name one in DRJIT_LIBLLVM_PATH)"
    if requested == "llvm_ad_rgb":
        raise BackendError(f"llvm_ad_rgb: {reason}")
    return Backend("scalar_rgb", None, reason)


def slow(backend: Backend) -> str:
    """What is said where the variant is slow and nobody asked for it; else nothing."""
    if backend.variant != "scalar_rgb" or backend.reason == _ASKED:
        return ""
    return f"references are rendered with {backend.variant}, which is slow: {backend.reason}"


def probe(variant: str, llvm_path: Path | None = None) -> str:
    """Render the closed form in a child process: `PASSED`, or what went wrong in one line.

    Remembered for this LLVM file, these versions of Mitsuba and Dr.Jit, and this machine: a pass, and a
    refusal by LLVM itself. Another failure may be mended by an installation, and costs less than a second.
    """
    stamp = llvm_path.stat().st_mtime_ns if llvm_path and llvm_path.exists() else 0
    # The instructions that LLVM must select depend on the processor.
    key = repr((variant, str(llvm_path), stamp, versions_of("mitsuba", "drjit"), platform.node(), platform.machine()))
    outcome_file = cache_folder() / "probes" / f"{hashlib.sha256(key.encode()).hexdigest()[:16]}.txt"
    if outcome_file.exists():
        return outcome_file.read_text()
    outcome = _probe_in_child(variant, llvm_path)
    if outcome == PASSED or "LLVM ERROR" in outcome:
        write_atomically(outcome_file, lambda path: path.write_text(outcome))
    return outcome


def _probe_in_child(variant: str, llvm_path: Path | None) -> str:
    code = f"from termwise.reference.backend import _render_closed_form as render; render({variant!r})"
    with tempfile.TemporaryDirectory() as home:
        # Dr.Jit keeps compiled kernels below HOME: those of a good LLVM would hide that this one fails.
        environment = os.environ | {"HOME": home}
        if llvm_path:
            environment["DRJIT_LIBLLVM_PATH"] = str(llvm_path)
        command = [sys.executable, "-c", code]
        try:
            done = subprocess.run(
                command, env=environment, cwd=ROOT, capture_output=True, text=True, timeout=_PROBE_SECONDS
            )
        except subprocess.TimeoutExpired:
            return f"the probe did not end within {_PROBE_SECONDS} s"
    if done.returncode == 0:
        return PASSED
    lines = [line for line in done.stderr.splitlines() if line.strip()] or [f"exit status {done.returncode}"]
    if done.returncode < 0:
        message = next((line for line in lines if "ERROR" in line), "")
        return f"the process ended by {signal.Signals(-done.returncode).name}. {message}".strip()
    # A BackendError speaks for itself, any other exception needs its name.
    return lines[-1].rpartition(f"{BackendError.__name__}: ")[2]


def _render_closed_form(variant: str) -> None:
    """Render the sphere with a BSDF written in Python, as the references' own are; raise unless L_o = 1."""
    mi = _activate(variant)
    dr: Any = importlib.import_module("drjit")

    class White(mi.BSDF):
        def __init__(self, props):
            mi.BSDF.__init__(self, props)
            self.m_components = [mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide]
            self.m_flags = self.m_components[0]

        def sample(self, ctx, si, sample1, sample2, active=True):
            bs = mi.BSDFSample3f()
            bs.wo = mi.warp.square_to_cosine_hemisphere(sample2)
            bs.pdf = mi.warp.square_to_cosine_hemisphere_pdf(bs.wo)
            bs.eta = 1
            bs.sampled_type = int(self.m_components[0])
            bs.sampled_component = 0
            # Minimum and maximum are the instructions that an old LLVM cannot select.
            return bs, mi.Color3f(dr.minimum(dr.maximum(1 + bs.wo.z, 0), 1))

        def eval(self, ctx, si, wo, active=True):
            return mi.Color3f(self.pdf(ctx, si, wo, active))

        def pdf(self, ctx, si, wo, active=True):
            return mi.warp.square_to_cosine_hemisphere_pdf(wo)

        def eval_pdf(self, ctx, si, wo, active=True):
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

    mi.register_bsdf("white", White)
    scene = {
        "type": "scene",
        "integrator": {"type": "direct", "emitter_samples": 0, "bsdf_samples": 1},
        "sensor": {
            "type": "perspective",
            "to_world": mi.ScalarTransform4f().look_at(origin=[0, 0, 3], target=[0, 0, 0], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}},
        },
        "sphere": {"type": "sphere", "bsdf": {"type": "white"}},
        "sky": {"type": "constant"},
    }
    image = mi.render(mi.load_dict(scene), spp=4).numpy()
    if not abs(image - 1).max() < 1e-5:
        raise BackendError(f"L_o comes out between {image.min():g} and {image.max():g} where it is 1")


def _activate(variant: str) -> Any:
    native.preload()
    mi = importlib.import_module("mitsuba")
    try:
        mi.set_variant(variant)
    except ImportError as error:
        raise BackendError(str(error).splitlines()[0]) from error
    return mi


_active: Backend | None = None


def import_mitsuba(requested: str | None = None) -> Any:
    """Return the module `mitsuba` with its variant set; the first call decides for the process.

    Raises
    ------
    ValueError, BackendError
        As `choose`; a library that Mitsuba links is missing; the process renders with another variant.
    """
    global _active
    mi: Any
    if _active is None:
        backend = choose(requested)
        if backend.llvm_path:
            os.environ["DRJIT_LIBLLVM_PATH"] = str(backend.llvm_path)
        _activate(backend.variant)
        _active = backend
    elif requested not in (None, _active.variant):
        raise BackendError(f"{requested}: this process already renders with {_active.variant}; start another")
    mi = importlib.import_module("mitsuba")
    if mi.variant() != _active.variant:  # a user's own
        mi.set_variant(_active.variant)
    return mi


@contextlib.contextmanager
def rendering() -> Iterator[Any]:
    """Mitsuba with our variant; afterwards a caller's own is set again.

    Raises
    ------
    ValueError, BackendError : as `import_mitsuba`.
    """
    loaded: Any = sys.modules.get("mitsuba")
    before = loaded.variant() if loaded else None
    try:
        yield import_mitsuba()
    finally:
        if before is not None and loaded.variant() != before:
            loaded.set_variant(before)


def limit_threads(count: int) -> None:
    """Let Dr.Jit use so many threads in this process; its results do not depend on them."""
    import_mitsuba()
    importlib.import_module("drjit").set_thread_count(count)


def active() -> Backend:
    """Return the backend of this process, started if it was not."""
    with rendering():
        assert _active is not None
        return _active


def main() -> None:
    """Fetch the native libraries that are missing and say what renders the references; never fail."""
    try:
        native.preload()
        if native.lacks_libatomic():
            _fetch(llvm=not native.llvm_libraries())
        if choose().variant == "scalar_rgb" and not os.environ.get("TERMWISE_BACKEND"):
            _fetch(llvm=True)
        backend = choose()
        print(f"termwise: references are rendered with {backend.variant}: {backend.reason}")
    except (BackendError, ValueError) as error:
        print(f"termwise: references cannot be rendered: {error}")


def _fetch(*, llvm: bool) -> None:
    print(
        f"termwise: fetching {'libatomic and LLVM' if llvm else 'libatomic'} into {native.fetched_folder()}", flush=True
    )
    try:
        native.fetch(llvm=llvm)
    except (native.FetchError, OSError) as error:
        print(f"termwise: nothing was fetched: {error}; `python -m reference.backend` tries again")


if __name__ == "__main__":
    main()
