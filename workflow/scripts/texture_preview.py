from brdfpipe import store
from brdfpipe.texture.distant_view import structure_previews


def main(input, output, params):
    """Pictures of the visible structure as an eye sees it from a distance."""
    inputs = {name: store.open_dataset(path) for name, path in input.items()}
    texture = inputs["texture" if "texture" in inputs else "picture_texture"]
    store.save_dataset(
        structure_previews(inputs["bsdf"], texture, inputs.get("unresolved"), **params["spec"]),
        output["preview"],
        stage="texture_preview",
        material=params["material"],
        inputs=inputs,
        parameters=params["spec"],
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
