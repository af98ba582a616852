"""Numba kernels: scalars and contiguous arrays in and out, no checks, no files, no messages."""
