from brdfpipe import store
from brdfpipe.appearance.finish_from_gloss import finish_from_gloss


def main(input, output, params):
    """Slope density of a finish that is known by gloss readings."""
    spec = params["spec"]
    inputs = {name: store.open_dataset(path, name) for name, path in input.items()}
    gloss = {float(angle): value for angle, value in spec["gloss"].items()}
    options = {name: value for name, value in spec.items() if name != "gloss"}
    store.save_dataset(
        finish_from_gloss(gloss, **inputs, **options),
        output["facets"],
        stage="facets",
        material=params["material"],
        inputs=inputs,
        parameters=spec,
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
