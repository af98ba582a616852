"""Films of the gallery: the ffmpeg that comes with imageio, whether or not there is another one."""

import logging

import imageio_ffmpeg
import matplotlib as mpl


def find_ffmpeg(gallery_conf, filename):
    """Tell matplotlib, which forgets it before each example; it need not say what it runs."""
    mpl.rcParams["animation.ffmpeg_path"] = imageio_ffmpeg.get_ffmpeg_exe()
    logging.getLogger("matplotlib").setLevel(logging.WARNING)
