from pathlib import Path

from brdfpipe import store
from brdfpipe.texture.picture_files import write_pictures
from brdfpipe.texture.picture_texture import of_files


def main(input, output, params):
    """The texture of an effect paint from pictures, with its sparkle and graininess."""
    paths = [Path(path) for path in input["pictures"]]
    texture = store.save_dataset(
        of_files(paths, **params["spec"]),
        output["texture"],
        stage="picture_texture",
        material=params["material"],
        inputs={f"picture-{number}": path for number, path in enumerate(paths, start=1)},
        parameters=params["spec"],
    )
    write_pictures(texture, Path(output["texture"]).parent / "exports", params["material"])


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
