"""Simulated buildings: furnished, lit, rendered by ray casting, and written in COLD's own layout.

    from siamloc.simulate import simulate

    summary = simulate(out="data", building="mini", runs=["cloudy1", "night1"], camera="panorama")
    print(summary)

or, step by step, without files:

    from siamloc.simulate import Run, build_scene, load_building, render

    scene = build_scene(load_building("mini"), Run("night", 1))
    panoramas = render(scene, scene.state.track.poses[:3])  # (3, 128, 512, 3) uint8

The modules, from a building's YAML file to a panorama: `layout` (what a building consists of), `parse` (its file),
`floor_plans`, `furnishing`, `route` and `buildings` (buildings by name or drawn), `plan` (free space), `months` (what
changes from month to month), `trajectory`, `odometry` and `run` (one drive), `mesh`, `shell`, `furniture`, `things`,
`items`, `textures`, `natural`, `prints` and `gloss` (what is visible), `sky` and `light` (light sources), `scene` (all
of these), `camera` and `rendering` (images), `overlap` (what two images, or months, have in common), `views` (many
images, quickly), and `produce` (the data set). Rendering needs the package embreex, installed by the extra "simulate".
"""

from foundation.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)
