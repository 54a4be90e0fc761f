"""The self-check of an installation: one line per thing looked at."""

from __future__ import annotations

import asyncio
import importlib
import platform
import shutil
import sys
from collections.abc import Callable, Iterator
from importlib import metadata
from pathlib import Path
from typing import Final, NamedTuple, get_args

from auv_mcm import __version__
from auv_mcm.errors import AuvMcmError, SelfCheckError
from auv_mcm.records import Detector
from auv_mcm.settings.config import Config
from auv_mcm.shell.sources import parse_source_uri

_PACKAGES: Final = {
    "numpy": "numpy",
    "scipy": "scipy",
    "opencv-contrib-python-headless": "cv2",
    "pyserial": "serial",
    "python-can": "can",
    "pyyaml": "yaml",
    "msgspec": "msgspec",
}
_BENCH_PACKAGES: Final = {name: name for name in ("pyxtf", "rich", "matplotlib", "jinja2", "dask", "distributed")}
_LEAST_FREE_BYTES: Final = 1 << 30


class Finding(NamedTuple):
    """What one look gave. A warning says that something works, but less well."""

    name: str
    verdict: str  # "ok", "warning" or "FAILED"
    detail: str


def run_checks(
    read_config: Callable[[], Config],
    write: Callable[[str], None],
    check_logs: Callable[[Config], Iterator[Finding]] = lambda config: iter(()),
) -> int:
    """Look at everything, write a table line by line, and return the exit code: 0, or SelfCheckError's if anything failed.

    A configuration that cannot be read is one of the findings. check_logs: findings about recorded logs.
    """
    failed = 0
    for finding in _findings(read_config, check_logs):
        write(f"{finding.verdict:8}{finding.name:32}{finding.detail}")
        failed += finding.verdict == "FAILED"
    write(f"{failed} failed" if failed else "all good")
    return SelfCheckError.exit_code if failed else 0


def _findings(read_config: Callable[[], Config], check_logs: Callable[[Config], Iterator[Finding]]) -> Iterator[Finding]:
    yield Finding("auv-mcm", "ok", f"{__version__} in {Path(__file__).parent}")
    yield Finding("python", "ok" if sys.version_info >= (3, 11) else "FAILED", f"{platform.python_version()} on {platform.machine()}")
    for package, module in _PACKAGES.items():
        yield _package(package, module, "FAILED", "python -m pip install auv-mcm")
    for package, module in _BENCH_PACKAGES.items():
        yield _package(package, module, "warning", "no replay, no report; python -m pip install 'auv-mcm[bench]'")
    yield _kernels()
    yield _simulator()
    yield _odds()
    config = Config()
    try:
        config = read_config()
        if config.service.source:
            parse_source_uri(config.service.source)
        yield Finding("configuration", "ok", "valid")
    except AuvMcmError as error:
        yield Finding("configuration", "FAILED", str(error))
    yield from check_logs(config)
    yield _detector(config)
    yield _output(Path(config.service.output_directory))
    yield _perception(config)


def _detector(config: Config) -> Finding:
    from auv_mcm.detect.cascade.choose import configured_model, fitting

    try:
        model, notice = fitting(configured_model(config), config)
        wanted = model is not None or notice.code == "detect.contrast"
        return Finding("detector", "ok" if wanted else "warning", notice.text)
    except (AuvMcmError, OSError) as error:
        return Finding("detector", "FAILED", str(error))


def _package(package: str, module: str, otherwise: str, remedy: str) -> Finding:
    try:
        importlib.import_module(module)
        return Finding(package, "ok", metadata.version(package))
    except (ImportError, metadata.PackageNotFoundError) as error:
        return Finding(package, otherwise, f"{error}: {remedy}")


def _kernels() -> Finding:
    import numpy as np

    from auv_mcm import kernels
    from auv_mcm.kernels.viterbi import viterbi_forward, viterbi_forward_numpy

    if kernels.backend() == "numpy":
        return Finding("C kernels", "warning", f"numpy does their work, more slowly: {kernels.loaded().reason}")
    random = np.random.default_rng(0)
    score = random.normal(size=(64, 257))
    score[random.random(score.shape) < 0.2] = -np.inf
    (cost, back), (cost_numpy, back_numpy) = viterbi_forward(score[0], score, 5, 0.3), viterbi_forward_numpy(score[0], score, 5, 0.3)
    same = np.array_equal(cost, cost_numpy) and np.array_equal(back, back_numpy)
    return Finding("C kernels", "ok" if same else "FAILED", f"{kernels.loaded().reason}, {'equal to' if same else 'NOT EQUAL to'} numpy")


def _simulator() -> Finding:
    import numpy as np

    from sim_replay.simulator import backend
    from sim_replay.simulator.speckle import gaussian_taps, row_keys, speckle_rows, speckle_rows_numpy

    name, loaded = "simulator kernels", backend.loaded()
    if loaded.library is None:
        return Finding(name, "warning", f"numpy does their work, more slowly: {loaded.reason}")
    energy, keys, taps = np.linspace(0.0, 2.0, 4 * 300).reshape(4, 300), row_keys(0, [0], 0, 4), gaussian_taps(1.5)
    same = np.array_equal(speckle_rows(energy, keys, taps), speckle_rows_numpy(energy, keys, taps))
    return Finding(name, "ok" if same else "FAILED", f"{loaded.reason}, {'equal to' if same else 'NOT EQUAL to'} numpy")


def _odds() -> Finding:
    from auv_mcm.classify.odds import shipped_odds

    try:
        told = "; ".join(f"{detector}: {shipped_odds(detector).fitted_on}" for detector in get_args(Detector))
        return Finding("odds of confirmation", "ok", told)
    except (AuvMcmError, OSError) as error:
        return Finding("odds of confirmation", "FAILED", str(error))


def _output(folder: Path) -> Finding:
    existing = next(parent for parent in (folder.absolute(), *folder.absolute().parents) if parent.exists())
    if not existing.is_dir():
        return Finding("output directory", "FAILED", f"{existing} is no directory (service.output_directory)")
    probe = existing / ".auv-mcm-check"
    try:
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        return Finding("output directory", "FAILED", f"{existing} cannot be written to: {error.strerror} (service.output_directory)")
    free_bytes = shutil.disk_usage(existing).free
    return Finding(
        "output directory", "ok" if free_bytes >= _LEAST_FREE_BYTES else "warning", f"{folder.absolute()}, {free_bytes / 1e9:.1f} GB free"
    )


def _perception(config: Config) -> Finding:
    from auv_mcm.shell.perception import Finished, Perception

    async def start_and_finish() -> None:
        perception = Perception(config)
        try:
            await perception.start()
            await perception.finish()
            while not isinstance(await perception.answer(), Finished):
                pass
        finally:
            perception.close()

    try:
        asyncio.run(start_and_finish())
    except (AuvMcmError, OSError) as error:
        return Finding("perception process", "FAILED", str(error))
    return Finding("perception process", "ok", "starts, answers and ends")
