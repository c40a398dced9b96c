from brdfpipe import store
from brdfpipe.bsdf.microfacet.interreflection import choose


def main(input, output, params):
    """The light that the height map reflects more than once, traced on it, where there is enough of it."""
    inputs = {name: store.open_dataset(path, name) for name, path in input.items()}
    spec = params["spec"]
    store.save_dataset(
        choose(**inputs, **spec),
        output["interreflection"],
        stage="interreflection",
        material=params["material"],
        inputs=inputs,
        parameters=spec,
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
