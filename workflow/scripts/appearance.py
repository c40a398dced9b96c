from brdfpipe import store
from brdfpipe.appearance.cabin import cabin_of
from brdfpipe.appearance.computation import compute_appearance


def main(input, output, params):
    """Gloss, haze, colours and further quantities of a BRDF."""
    bsdf = store.shared_dataset(input["bsdf"], "bsdf")
    spec = params["spec"]
    cabin = {"cabin": cabin_of(spec["cabin"])} if "cabin" in spec else {}
    store.save_dataset(
        compute_appearance(bsdf, **spec | cabin),
        output["appearance"],
        stage="appearance",
        material=params["material"],
        inputs={"bsdf": bsdf},
        parameters=spec,
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
