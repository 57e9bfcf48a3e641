"""Which Mitsuba variant runs, and with which LLVM: tried in a subprocess before it is used, and named in the log.

Dr.Jit left alone would search the system for libLLVM; version 15 aborts the whole process at the first spectral
kernel. So an LLVM variant is set only with DRJIT_LIBLLVM_PATH naming a library that passed a trial in a subprocess.
"""

import contextlib
import functools
import hashlib
import importlib.metadata
import json
import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from huesphere.configs.errors import InputError
from huesphere.configs.own_folder import is_private, write_text
from huesphere.configs.quiet import silence
from huesphere.configs.regular_file import read_text

LLVM_VARIANT = "llvm_ad_spectral"
CUDA_VARIANT = "cuda_ad_spectral"
SCALAR_VARIANT = "scalar_spectral"
THREADS = "HUESPHERE_THREADS"  # in the environment: how many Dr.Jit may use; all without it
VERDICT_BYTES = 10_000  # most of the file that a verdict is remembered in
LLVM_PACKAGE = "karellen-llvm-core"
ABORTING_VERSIONS = (15,)  # measured with Mitsuba 3.9.1: SIGABRT at the first spectral kernel
OLDEST_VERSION = 16  # Dr.Jit refuses 14 and older for what we need

# The trial of a library: a spectral kernel is compiled and run. Exit code 0 and the word "survived" mean success.
PROBE = """
import sys
import mitsuba as mi
mi.set_variant(sys.argv[1])
import drjit as dr
scene = mi.load_dict({"type": "scene", "shape": {"type": "sphere"}, "emitter": {"type": "constant"},
    "integrator": {"type": "path", "max_depth": 2},
    "sensor": {"type": "perspective", "film": {"type": "specfilm", "width": 4, "height": 4,
        "component_format": "float32",
        "band": {"type": "regular", "wavelength_min": 400, "wavelength_max": 700, "values": "1, 1"}}}})
print("survived", dr.sum(mi.render(scene, spp=1).array)[0] >= 0)
"""


@dataclass(frozen=True)
class Backend:
    """A Mitsuba variant and why it was chosen."""

    variant: str
    llvm: str | None  # path of libLLVM, None for CUDA and scalar
    reason: str  # one line for the log

    @property
    def vectorised(self) -> bool:
        """Whether Dr.Jit has arrays (LLVM or CUDA), which the transport engine needs."""
        return self.variant != SCALAR_VARIANT


@functools.cache
def choose_backend() -> Backend:
    """CUDA where there is a device, else LLVM with a library that survives a trial, else the scalar variant."""
    if _cuda_device_present() and _survives(CUDA_VARIANT, None):
        return Backend(CUDA_VARIANT, None, "CUDA device")
    rejected = []
    for path in llvm_candidates():
        verdict = _verdict(path)
        if verdict is None:
            return Backend(LLVM_VARIANT, str(path), f"LLVM {path.name}")
        rejected.append(f"{path.name}: {verdict}")
    why = "; ".join(rejected) if rejected else f"no libLLVM found (pip install {LLVM_PACKAGE})"
    return Backend(SCALAR_VARIANT, None, f"no usable LLVM ({why})")


def load_mitsuba(backend: Backend) -> ModuleType:
    """Import Mitsuba with the chosen variant set. One process keeps one backend."""
    # An explicit path, even of a file that does not exist, keeps Dr.Jit from searching the system.
    os.environ["DRJIT_LIBLLVM_PATH"] = backend.llvm or os.devnull
    # Dr.Jit's C++ side warns about a path without a file, which is set on purpose.
    with silence() if backend.llvm is None else contextlib.nullcontext():
        import mitsuba as mi

        if mi.variant() != backend.variant:
            mi.set_variant(backend.variant)
    if os.environ.get(THREADS, "").isdecimal():
        import drjit

        drjit.set_thread_count(int(os.environ[THREADS]))
    return mi


def is_scalar(mi: ModuleType) -> bool:
    """Whether the variant that is set has no arrays; all values of such a variant are single numbers."""
    return str(mi.variant()).startswith("scalar")


def require_vectorised(mi: ModuleType, what: str) -> None:
    """Raise InputError where the variant is scalar, for which Mitsuba has no plug-ins written in Python.

    ``what``: the words of the error before "only with LLVM or CUDA".
    """
    if is_scalar(mi):
        raise InputError(f"{what} only with LLVM or CUDA", got=mi.variant())


def llvm_candidates() -> list[Path]:
    """Libraries worth a trial, best first: the user's own choice, the PyPI package's, then the system's newest."""
    found: list[Path] = []
    chosen = os.environ.get("DRJIT_LIBLLVM_PATH")
    if chosen and chosen != os.devnull:
        found.append(Path(chosen))
    if os.environ.get("HUESPHERE_LLVM") == "none":
        return []  # asked for: the scalar variant needs none
    found += _packaged_llvm()
    found += sorted(_system_llvm(), key=_version, reverse=True)
    return list(dict.fromkeys(found))


def _packaged_llvm() -> list[Path]:
    try:
        files = importlib.metadata.files(LLVM_PACKAGE) or []
    except importlib.metadata.PackageNotFoundError:
        return []
    libraries = [
        Path(str(f.locate())).resolve() for f in files if re.fullmatch(r"libLLVM(-\d+)?\.(so[.\d]*|dylib)", f.name)
    ]
    return sorted({path for path in libraries if path.is_file()})


def _system_llvm() -> list[Path]:
    roots = [Path("/usr/lib"), Path("/usr/lib64"), Path("/usr/local/lib"), Path("/opt/homebrew/opt/llvm/lib")]
    patterns = ("libLLVM*.so*", "*/libLLVM*.so*", "llvm-*/lib/libLLVM*.so*", "libLLVM*.dylib")
    links = {path for root in roots for pattern in patterns for path in root.glob(pattern)}
    return sorted(
        {path.resolve() for path in links if re.match(r"libLLVM[-.\d]", path.name) and path.resolve().is_file()}
    )


def _version(path: Path) -> int:
    """Major version in the name of an LLVM library; 0 where the name has none, and only a trial can tell."""
    match = re.search(r"libLLVM[-.a-z]*(\d+)", path.name)
    return int(match.group(1)) if match else 0


def _verdict(path: Path) -> str | None:
    """Why ``path`` must not be loaded, or None if it survived a trial."""
    if not path.is_file():
        return "no such file"
    version = _version(path.resolve())
    if version in ABORTING_VERSIONS:
        return f"version {version} aborts Mitsuba"
    if 0 < version < OLDEST_VERSION:
        return f"version {version} is too old"
    return None if _survives(LLVM_VARIANT, path) else "did not survive a trial kernel"


def _survives(variant: str, llvm: Path | None) -> bool:
    """Run the probe in a subprocess; the verdict is remembered per library, Mitsuba version and Python."""
    memory = _memory_file(variant, llvm)
    if memory is not None and is_private(memory.parent):
        try:
            return bool(json.loads(read_text(memory, most=VERDICT_BYTES, follow=False))["survived"])
        except (OSError, ValueError, KeyError, TypeError):
            pass  # a damaged record of verdicts counts as none
    environment = dict(os.environ, DRJIT_LIBLLVM_PATH=str(llvm) if llvm else os.devnull)
    try:
        trial = subprocess.run(
            [sys.executable, "-c", PROBE, variant], env=environment, capture_output=True, text=True, timeout=120
        )
        survived = trial.returncode == 0 and "survived True" in trial.stdout
    except (OSError, subprocess.TimeoutExpired):
        survived = False
    if memory is not None:
        with contextlib.suppress(OSError):  # a read-only home only costs the next start another trial
            memory.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            if is_private(memory.parent):
                write_text(memory, json.dumps({"survived": survived, "variant": variant, "llvm": str(llvm)}))
    return survived


def _memory_file(variant: str, llvm: Path | None) -> Path | None:
    """Where the verdict is remembered: below the user's own cache folder; None without one.

    A folder that others can write to, such as /tmp, would let them decide which library is loaded.
    """
    stamp = [variant, importlib.metadata.version("mitsuba"), importlib.metadata.version("drjit"), sys.version]
    if llvm is not None:
        status = llvm.stat()
        stamp += [str(llvm.resolve()), str(status.st_size), str(status.st_mtime_ns)]
    key = hashlib.sha256("\n".join(stamp).encode()).hexdigest()[:16]
    root = os.environ.get("XDG_CACHE_HOME") or (Path.home() / ".cache" if _has_home() else None)
    return None if root is None else Path(root) / "huesphere" / f"backend-{key}.json"


def _has_home() -> bool:
    try:
        return Path.home().is_dir()
    except RuntimeError:
        return False


def _cuda_device_present() -> bool:
    return Path("/dev/nvidia0").exists() or bool(os.environ.get("CUDA_VISIBLE_DEVICES"))
