"""Ends of the names of the files that a texture is written to, beside the exports of a material."""

MAP_FILES = (".height.png", ".normal.png", ".height.exr", ".normal.exr", ".maps.json")
"""Maps of a scan (:mod:`brdfpipe.texture.map_files`)."""

PICTURE_FILES = (
    *(f".texture-{number}{end}" for number in range(1, 9) for end in (".png", ".exr")),
    ".texture.json",
)
"""Textures of pictures (:mod:`brdfpipe.texture.picture_files`)."""

TEXTURED_FORMATS = {"gltf": ".textured.gltf", "openpbr": ".textured.mtlx", "rgl": ".textured.xml"}
"""Format of ``exports`` → end of the name of the material with maps (:mod:`brdfpipe.texture.renderer_files`)."""

RENDERER_FILES = (*TEXTURED_FORMATS.values(), ".unresolved.rgb.bsdf", ".unresolved.rgb.bsdf.json")
"""Those files, and the table that the scene of Mitsuba reads."""

PAINT_FILES = (*TEXTURED_FORMATS.values(), ".textured.png", ".textured.rgb.bsdf", ".textured.rgb.bsdf.json")
"""Materials of renderers with the texture of a paint (:mod:`brdfpipe.texture.paint_files`), and the picture and the table that these read."""
