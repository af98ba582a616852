"""
In three dimensions
===================

``rtin.viewer.pictures`` draws terrain without a screen; ``snapshot`` writes it to a file. What
``rtin view`` shows in the browser looks the same.
"""

import matplotlib.pyplot as plt

from rtin import samples
from rtin.viewer.colours import by_error
from rtin.viewer.pictures import as_terrain, picture
from rtin.viewer.scene import Settings, Terrain, View

grid = samples.jacksboro_fault().in_metres()
terrain = as_terrain(grid)
view = View((-35.0, -62.0, 30.0), (-4.0, -8.0, 0.0), field_of_view=45.0)


def show(terrain, settings, caption):
    """Draw the terrain from there."""
    fig = plt.figure(figsize=(8.8, 5.0))
    ax = fig.add_axes((0, 0, 1, 1))
    ax.imshow(picture(terrain, view, settings=settings, size=(880, 500)))
    ax.text(20, 36, caption, fontsize=12)
    ax.set_axis_off()
    plt.show()


show(terrain, Settings(exaggeration=2.0), "within a pixel; heights doubled")

# %%
# The triangles, where four pixels are enough: small near the eye, large far away.

show(
    terrain,
    Settings(pixel_error=4.0, wireframe=True, exaggeration=2.0),
    "within four pixels: the triangles",
)

# %%
# How far that mesh is from the raster, of what it may be: pale where it is exact, nearly black where
# it is off by all of the four pixels. What is far away may be off by more metres.

show(
    Terrain(grid, painters={"error": by_error(grid)}),
    Settings(pixel_error=4.0, colours="error", exaggeration=2.0),
    "the error that four pixels allow",
)
