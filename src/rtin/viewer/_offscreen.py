"""Whether VTK has something to draw with: where it has not, it ends the process.

No wheel of VTK holds a renderer: it looks for X, then for EGL, then for OSMesa. An EGL that is
there without a driver, as in many containers, looks just like one that works until it is begun.
"""

from __future__ import annotations

import ctypes
import os
import sys
from ctypes.util import find_library

__all__ = ["require_renderer"]

_WINDOW = "VTK_DEFAULT_OPENGL_WINDOW"
_MISSING = (
    "there is neither a screen nor anything to draw with without one: "
    "apt-get install libegl1 libgl1-mesa-dri (Debian), or dnf install mesa-libEGL mesa-dri-drivers "
    "(Fedora)"
)
_PLATFORM_DEVICE = 0x313F  # EGL_EXT_platform_device
_MOST_DEVICES = 32


def require_renderer() -> None:
    """Raise OSError where VTK would find nothing to draw with; set what it needs to draw with EGL.

    On Linux only: elsewhere there is always something.
    """
    if not sys.platform.startswith("linux") or _WINDOW in os.environ or _has_screen():
        return
    if _has_egl():
        os.environ[_WINDOW] = "vtkEGLRenderWindow"
    elif not find_library("OSMesa"):
        raise OSError(_MISSING)


def _has_screen() -> bool:
    """Return whether an X server answers; a DISPLAY may be left over from one that did."""
    library = _loaded("libX11.so.6") if os.environ.get("DISPLAY") else None
    if library is None:
        return False
    library.XOpenDisplay.restype = ctypes.c_void_p
    library.XCloseDisplay.argtypes = [ctypes.c_void_p]
    display = library.XOpenDisplay(None)
    if display:
        library.XCloseDisplay(display)
    return bool(display)


def _has_egl() -> bool:
    """Return whether one of EGL's devices can be begun: a GPU, or a driver that draws on CPUs."""
    library = _loaded("libEGL.so.1")
    if library is None:
        return False
    find = library.eglGetProcAddress
    find.restype, find.argtypes = ctypes.c_void_p, [ctypes.c_char_p]
    query, display_of = find(b"eglQueryDevicesEXT"), find(b"eglGetPlatformDisplayEXT")
    if not query or not display_of:
        return False
    pointer, number = ctypes.c_void_p, ctypes.c_uint
    devices, n_devices = (pointer * _MOST_DEVICES)(), ctypes.c_int(0)
    ask = ctypes.CFUNCTYPE(number, ctypes.c_int, pointer, pointer)(query)
    ask(_MOST_DEVICES, devices, ctypes.byref(n_devices))
    display = ctypes.CFUNCTYPE(pointer, number, pointer, pointer)(display_of)
    shown = (display(_PLATFORM_DEVICE, device, None) for device in devices[: n_devices.value])
    return any(_begins(library, one) for one in shown if one)


def _begins(library: ctypes.CDLL, display: int) -> bool:
    library.eglInitialize.argtypes = [ctypes.c_void_p] * 3
    library.eglTerminate.argtypes = [ctypes.c_void_p]
    if not library.eglInitialize(display, None, None):
        return False
    library.eglTerminate(display)
    return True


def _loaded(name: str) -> ctypes.CDLL | None:
    try:
        return ctypes.CDLL(name)
    except OSError:
        return None
