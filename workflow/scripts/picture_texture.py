from pathlib import Path

from brdfpipe import store
from brdfpipe.texture.paint_files import with_paint_files
from brdfpipe.texture.picture_files import write_pictures
from brdfpipe.texture.picture_texture import of_files


def main(input, output, params):
    """The texture of an effect paint from pictures, with its sparkle and graininess, and materials of renderers with it."""
    paths, bsdf = [Path(path) for path in input["pictures"]], store.open_dataset(input["bsdf"], "bsdf")
    options = {key: value for key, value in params["spec"].items() if key != "formats"}
    folder, texture = Path(output["texture"]).parent / "exports", of_files(paths, **options)
    write_pictures(texture, folder, params["material"])
    store.save_dataset(
        with_paint_files(texture, bsdf, folder, params["material"], params["spec"]["formats"]),
        output["texture"],
        stage="picture_texture",
        material=params["material"],
        inputs={"bsdf": bsdf} | {f"picture-{number}": path for number, path in enumerate(paths, start=1)},
        parameters=params["spec"],
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
