"""Only the optional C extension; everything else is in pyproject.toml.

The library has no Python.h and no init function: it is loaded through ctypes. Without a compiler the installation goes on
and numpy does the same work. No -march=native (one build serves every machine of an architecture) and no -ffast-math; no
fused multiply-adds, so that C and numpy round alike.
"""

from setuptools import Extension, setup

setup(
    ext_modules=[
        Extension(
            "auv_mcm.kernels._kernels",
            sources=["auv_mcm/kernels/kernels.c"],
            extra_compile_args=["-std=c99", "-O3", "-ffp-contract=off"],
            optional=True,
        )
    ]
)
