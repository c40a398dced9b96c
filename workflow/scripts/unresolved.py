from pathlib import Path

from brdfpipe import store
from brdfpipe.texture.renderer_files import with_renderer_files
from brdfpipe.texture.unresolved import unresolved_bsdf


def main(input, output, params):
    """The BSDF of what the pixels of a texture do not resolve, and materials of renderers with both."""
    inputs = {name: store.open_dataset(path, name) for name, path in input.items()}
    rest = unresolved_bsdf(**inputs).assign_attrs(material=params["material"])
    folder = Path(output["unresolved"]).parent / "exports"
    store.save_dataset(
        with_renderer_files(inputs["texture"], rest, folder, params["material"], **params["spec"]),
        output["unresolved"],
        stage="unresolved",
        material=params["material"],
        inputs=inputs,
        parameters=params["spec"],
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
