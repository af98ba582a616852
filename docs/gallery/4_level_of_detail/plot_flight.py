"""
A flight over the mountains
===========================

A budget that is held from picture to picture: near the eye triangles are small, and they follow it.
``rtin view dem.tif --record flight.mp4`` writes such a film.
"""

import matplotlib.pyplot as plt
from matplotlib.animation import FuncAnimation

from rtin import samples
from rtin.viewer.cameras import flight
from rtin.viewer.pictures import as_terrain, picture
from rtin.viewer.scene import Settings

grid = samples.jacksboro_fault().in_metres()
terrain = as_terrain(grid)
views = flight(grid, terrain.place, 120, exaggeration=2.0)[:24]
look = Settings("triangle budget", max_triangles=5000, wireframe=True, exaggeration=2.0)
pictures = [picture(terrain, view, settings=look, size=(810, 450)) for view in views]

fig = plt.figure(figsize=(7.2, 4.0))
ax = fig.add_axes((0, 0, 1, 1))
ax.set_axis_off()
image = ax.imshow(pictures[0])
film = FuncAnimation(fig, lambda frame: image.set_data(frame), pictures, interval=120)
plt.show()
