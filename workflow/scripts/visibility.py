from brdfpipe import store
from brdfpipe.masking.visibility_choice import choose


def main(input, output, params):
    """Visibility of the facets, traced on their heights, beside Smith's."""
    inputs = {name: store.open_dataset(path, name) for name, path in input.items()}
    spec = params["spec"]
    store.save_dataset(
        choose(**inputs, **spec),
        output["visibility"],
        stage="visibility",
        material=params["material"],
        inputs=inputs,
        parameters=spec,
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
