"""Only the optional C extensions; everything else is in pyproject.toml.

The libraries have no Python.h and no init function: they are loaded through ctypes, so that one wheel serves every
Python. Without a compiler the installation goes on and numpy does the same work. No -march=native (one build serves
every machine of an architecture) and no -ffast-math; no fused multiply-adds, so that C and numpy round alike.
"""

from glob import glob

from setuptools import Extension, setup

_SOURCES = {
    "auv_mcm.kernels._kernels": sorted(glob("auv_mcm/kernels/*.c")),
    "sim_replay.simulator._simulator": sorted(glob("sim_replay/simulator/*.c")),
}

# -fno-math-errno and -fno-trapping-math let the compiler use vector instructions; neither changes a result. -g0 leaves
# out what debuggers read, in which the folder of the build stands: the same sources give the same bytes.
_FLAGS = ["-std=c99", "-O3", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math", "-g0"]

_HEADERS = sorted(glob("auv_mcm/kernels/*.h") + glob("sim_replay/simulator/*.h"))

setup(
    ext_modules=[
        Extension(
            name, sources=sources, depends=_HEADERS, extra_compile_args=_FLAGS, optional=True, py_limited_api=True
        )
        for name, sources in _SOURCES.items()
    ],
    options={"bdist_wheel": {"py_limited_api": "cp311"}},
)
