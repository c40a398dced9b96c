from pathlib import Path

from brdfpipe import store
from brdfpipe.texture.map_files import write_maps
from brdfpipe.texture.scan_texture import of_scan


def main(input, output, params):
    """The grain of a scan as a tileable map, and the facets that its pixels do not resolve."""
    inputs = {name: store.open_dataset(path, name) for name, path in input.items()}
    texture = store.save_dataset(
        of_scan(**inputs, **params["spec"]),
        output["texture"],
        stage="texture",
        material=params["material"],
        inputs=inputs,
        parameters=params["spec"],
    )
    write_maps(texture, Path(output["texture"]).parent / "exports", params["material"])


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
