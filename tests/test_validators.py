"""Files of whole jobs, read by others' validators and by decoders written from specifications."""

import gzip
import json
from types import SimpleNamespace

import numpy as np
import pytest
import rasterio
from affine import Affine

import quantized_mesh_decoder
import rtin
import tileset_reader
from node import assert_valid_3d_tiles, assert_valid_gltf
from rtin import samples
from rtin.schemes import SCHEMES
from surfaces_of_the_world import island
