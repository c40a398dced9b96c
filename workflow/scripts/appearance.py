from brdfpipe import store
from brdfpipe.appearance.computation import compute_appearance


def main(input, output, params):
    """Gloss, haze, colours and a preview of a BRDF."""
    bsdf = store.open_dataset(input["bsdf"], "bsdf")
    store.save_dataset(
        compute_appearance(bsdf, **params["spec"]),
        output["appearance"],
        stage="appearance",
        material=params["material"],
        inputs={"bsdf": bsdf},
        parameters=params["spec"],
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
