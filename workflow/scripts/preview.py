from brdfpipe import store
from brdfpipe.appearance.preview import png, preview


def main(input, output, params):
    """A picture of the material."""
    bsdf = store.shared_dataset(input["bsdf"], "bsdf")
    picture = store.save_dataset(
        preview(bsdf, **params["spec"]),
        output["preview"],
        stage="preview",
        material=params["material"],
        inputs={"bsdf": bsdf},
        parameters=params["spec"],
    )
    store.write_bytes(output["png"], png(picture))


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
