from .scene import Scene as Scene
from .scene import SceneError as SceneError
from .scene import load_scene as load_scene
from .scene import shipped_scenes as shipped_scenes
